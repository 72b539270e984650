"""Fixtures and settings of the tests, which those of benchmarks share."""

from tests.conftest import shared_data, started

__all__ = ["shared_data", "started"]
