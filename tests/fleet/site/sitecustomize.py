"""Puts the stub of the engine into every process that has this folder on its path."""

from tests.fleet.stub import install

install()
