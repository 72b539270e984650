"""Runs over logs on many machines, with buckets, Ray or job arrays."""

from jaxdet.fleet.command import run_fleet
from jaxdet.fleet.logs import list_logs, share_of
from jaxdet.fleet.publish import download, result_files
from jaxdet.fleet.run_log import prepare, run_log, run_logs

__all__ = [
    "download",
    "list_logs",
    "prepare",
    "result_files",
    "run_fleet",
    "run_log",
    "run_logs",
    "share_of",
]
