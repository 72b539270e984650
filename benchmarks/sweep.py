"""Each stage and the whole pipeline over batch sizes, image sizes and feature slots."""

from dataclasses import replace
from importlib import import_module
from typing import NamedTuple

import jax

from benchmarks.run import Case
from benchmarks.scene import CONFIG, frames_of
from jaxdet.pipeline import detect
from jaxdet.stages._device import on_cuda

SIZES = ("640x480", "848x480-1280x720", "1280x720")
SLOTS = (512, 1024, 4096)
ALL_SLOTS = (256, 512, 1024, 2048, 4096, 8192)
DEFAULT_SLOTS = 1024
BATCHES = {"cpu": (1, 4, 16), "gpu": (16, 256, 1024)}
ALL_BATCHES = {"cpu": (1, 2, 4, 8, 16, 32, 64), "gpu": (1, 4, 16, 64, 256, 512, 1024)}
DEFAULT_BATCH = {"cpu": 8, "gpu": 256}
AXES = {
    "align": ("batch", "size"),
    "cells": ("batch", "size"),
    "floor": ("batch", "size"),
    "surfaces": ("batch", "size"),
    "features": ("batch", "size", "slots"),
    "obstacles": ("batch", "size"),
    "outlines": ("batch", "size"),
    "free": ("batch", "size"),
    "cluster": ("batch", "slots"),
    "footprint": ("batch", "slots"),
    "pipeline": ("batch", "size", "slots"),
}
"""The stages, and what the cost of each can depend on. Only the preset ``paper`` has ``align``,
``cluster`` and ``footprint``, only the default what is on cells: ``cells``, ``floor``,
``surfaces``, ``obstacles``, ``outlines`` and ``free``."""


class Point(NamedTuple):
    """Where a stage is timed."""

    size: str
    """A key of ``benchmarks.scene.CALIBRATIONS``; empty where it doesn't matter."""
    slots: int
    """Feature slots N of a frame; 0 where it doesn't matter."""
    batch: int
    """Frames of a call."""

    @property
    def name(self) -> str:
        """Last part of the metric keys, for instance ``640x480.n1024.b8``."""
        parts = self.size, f"n{self.slots}" if self.slots else "", f"b{self.batch}"
        return ".".join(part for part in parts if part)


def kind() -> str:
    """``cpu`` or ``gpu``, the kind of JAX's default device."""
    return "gpu" if on_cuda() else "cpu"


def points_of(stage: str, device: str, full: bool) -> list[Point]:
    """The points at which a stage is timed: along each of its axes through the default.

    Args:
        stage: A key of :data:`AXES`.
        device: ``cpu`` or ``gpu``.
        full: More batch sizes and feature slots.
    """
    batches, slots = (ALL_BATCHES, ALL_SLOTS) if full else (BATCHES, SLOTS)
    middle = Point(
        SIZES[0] if "size" in AXES[stage] else "",
        DEFAULT_SLOTS if "slots" in AXES[stage] else 0,
        DEFAULT_BATCH[device],
    )
    axes = {
        "batch": [middle._replace(batch=batch) for batch in batches[device]],
        "size": [middle._replace(size=size) for size in SIZES],
        "slots": [middle._replace(slots=n) for n in slots],
    }
    return list(dict.fromkeys(point for axis in AXES[stage] for point in axes[axis]))


def case_at(stage: str, point: Point) -> Case:
    """A stage, or the pipeline, on images or points that lie on the device."""
    if stage == "pipeline":
        return _pipeline(point)
    return import_module(f"benchmarks.bench_{stage}").at(point)


def _pipeline(point: Point) -> Case:
    frames = frames_of(point.size, point.batch)
    color, depth = jax.device_put((frames.color, frames.depth))
    frames = frames._replace(color=color, depth=depth)
    features = replace(CONFIG.features, max_corners=point.slots)
    config = replace(CONFIG, features=features)
    return Case(
        name=point.name,
        run=lambda: detect(frames, config),
        frames=point.batch,
        bytes_read=color.nbytes + depth.nbytes,
    )
