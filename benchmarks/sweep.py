"""Parameter sweep: batch sizes, image sizes and feature slots for each stage and the pipeline."""

from typing import NamedTuple

from jaxdet.stages._batches import on_cuda

SIZES = ("640x480", "848x480-1280x720", "1280x720")
SLOTS = (512, 1024, 4096)
DEFAULT_SLOTS = 1024
BATCHES = {"cpu": (1, 4, 16), "gpu": (16, 256, 1024)}
DEFAULT_BATCH = {"cpu": 8, "gpu": 256}
AXES = {
    "align": ("batch", "size"),
    "cells": ("batch", "size"),
    "floor": ("batch", "size"),
    "surfaces": ("batch", "size"),
    "obstacles": ("batch", "size"),
    "outlines": ("batch", "size"),
    "free": ("batch", "size"),
    "features": ("batch", "size", "slots"),
    "cluster": ("batch", "slots"),
    "footprint": ("batch", "slots"),
    "pipeline": ("batch", "size"),
}
"""Stages, and the parameters on which their cost can depend. ``align``, ``features``, ``cluster``
and ``footprint`` belong to the preset ``paper``; the stages on cells (``cells``, ``floor``,
``surfaces``, ``obstacles``, ``outlines`` and ``free``) belong to the default."""


class Point(NamedTuple):
    """Parameters of one timing."""

    size: str
    """A key of ``benchmarks.scene.CALIBRATIONS``; empty if irrelevant."""
    slots: int
    """Feature slots N of a frame; 0 if irrelevant."""
    batch: int
    """Frames per call."""

    @property
    def name(self) -> str:
        """Return the last part of the metric keys, for instance ``640x480.n1024.b8``."""
        parts = self.size, f"n{self.slots}" if self.slots else "", f"b{self.batch}"
        return ".".join(part for part in parts if part)


def kind() -> str:
    """Return ``cpu`` or ``gpu``, the kind of JAX's default device."""
    return "gpu" if on_cuda() else "cpu"


def points_of(stage: str, device: str) -> list[Point]:
    """Return the points at which a stage is timed: along each of its axes through the default.

    Args:
        stage: A key of :data:`AXES`.
        device: ``cpu`` or ``gpu``.
    """
    middle = Point(
        SIZES[0] if "size" in AXES[stage] else "",
        DEFAULT_SLOTS if "slots" in AXES[stage] else 0,
        DEFAULT_BATCH[device],
    )
    axes = {
        "batch": [middle._replace(batch=batch) for batch in BATCHES[device]],
        "size": [middle._replace(size=size) for size in SIZES],
        "slots": [middle._replace(slots=n) for n in SLOTS],
    }
    return list(dict.fromkeys(point for axis in AXES[stage] for point in axes[axis]))
