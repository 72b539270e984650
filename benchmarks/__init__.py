"""Benchmarks of the processing stages; see ``python -m benchmarks --help``."""
