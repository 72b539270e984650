"""Fuzzing of logs, calibrations, calls, results and interrupted runs."""
