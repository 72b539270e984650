__all__ = [
    "Finding",
    "Report",
    "verify",
]

from .folder import verify
from .report import Finding, Report
