"""Fixtures and settings of the tests, shared with the tests of the benchmarks."""

from tests.conftest import shared_data, started

__all__ = ["shared_data", "started"]
