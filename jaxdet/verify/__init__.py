"""Checks of results against their manifest, their logs and the reference (``jaxdet verify``)."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxdet.verify.folder import verify
    from jaxdet.verify.report import Finding, Report

_HOMES = {"Finding": "report", "Report": "report", "verify": "folder"}

__all__ = ["Finding", "Report", "verify"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
