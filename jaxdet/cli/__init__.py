"""The command line. ``jaxdet --help`` imports no heavy package."""

from jaxdet.cli.main import main

__all__ = ["main"]
