"""The command line; ``jaxdet --help`` loads nothing heavy."""

from jaxdet.cli.main import main

__all__ = ["main"]
