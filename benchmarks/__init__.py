"""Benchmarks of the five stages; ``python -m benchmarks --help``."""
