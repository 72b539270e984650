"""What a baseline is, and how one is run."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from itertools import product
from typing import Any

import numpy as np

from benchmarks.baselines.frames import (
    Frame,
    Space,
    detections_of,
    labels_at,
    points_of,
)
from jaxdet.config import Config
from jaxdet.types import Detections

Params = Mapping[str, Any]


@dataclass(frozen=True)
class Baseline:
    """A method to compare with.

    Attributes:
        name: Its key.
        title: Its name in a table.
        run: ``run(points, **params) -> labels``. In the spaces ``xz`` and ``xyz`` the points are
            the frame's kept features, ``(n, 2)`` or ``(n, 3)`` float64 in metres, n >= 2, and the
            labels ``(n,)`` integer, negative = noise. In the space ``frame`` it is ``run(frame,
            config, **params)`` with the same labels, in the space ``image`` ``run(frame,
            **params)`` with labels ``(H, W)``.
        space: See ``run``.
        defaults: Every parameter with a value for untuned use.
        grid: The values that :func:`benchmarks.baselines.tune` begins with, by parameter.
        citation: Where the method is from.
        needs: Modules that it imports.
        sized: ``run`` takes ``min_points``, the shared size rule, because the method has one.
    """

    name: str
    title: str
    run: Callable[..., np.ndarray]
    space: Space
    citation: str
    defaults: Params = field(default_factory=dict)
    grid: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    needs: tuple[str, ...] = ()
    sized: bool = False

    @property
    def missing(self) -> str | None:
        """Why it can't run here; None where it can."""
        for module in self.needs:
            try:
                import_module(module)
            except (ImportError, OSError) as error:
                return f"{self.title} needs {module}: {error}"
        return None

    def trials(self) -> list[dict[str, Any]]:
        """Every combination of the grid's values."""
        return [
            dict(zip(self.grid, values, strict=True)) for values in product(*self.grid.values())
        ]

    def numbers(self) -> list[str]:
        """The parameters of the grid that are numbers, and have several values."""
        return [
            name
            for name, values in self.grid.items()
            if len(values) > 1 and not isinstance(values[0], bool | str)
        ]


def labels_of(
    baseline: Baseline, frame: Frame, config: Config | None = None, params: Params | None = None
) -> np.ndarray:
    """What a baseline says of a frame, before the shared size rule; the part to be timed.

    The parameter ``depth_scale``, in the spaces ``xz`` and ``xyz``, stretches z before the method
    sees it, since a sensor's depth and its sides deserve different thresholds, as ours have.

    Args:
        baseline: The method.
        frame: Preprocessed as for ours.
        config: For the size rule.
        params: Over the defaults.

    Returns:
        ``(n,)`` int32 of the kept features; in the space ``image`` ``(H, W)`` int32.
    """
    config, settings = config or Config(), {**baseline.defaults, **(params or {})}
    if baseline.space == "image":
        return baseline.run(frame, **settings)
    if baseline.space == "frame":
        return baseline.run(frame, config, **settings)
    points = points_of(frame, baseline.space)
    points[:, -1] *= settings.pop("depth_scale", 1.0)
    if len(points) < 2:
        return np.full(len(points), -1, np.int32)
    if baseline.sized:
        settings["min_points"] = config.cluster.min_points
    return np.asarray(baseline.run(points, **settings)).astype(np.int32)


def detect_with(
    baseline: Baseline,
    frame: Frame,
    config: Config | None = None,
    params: Params | None = None,
) -> Detections:
    """One frame's obstacles by a baseline, as the pipeline returns them.

    Args:
        baseline: The method.
        frame: Preprocessed as for ours.
        config: The shared size rule and the outline's parameters.
        params: Over the baseline's defaults.

    Returns:
        ``B = 1``.
    """
    config, features = config or Config(), frame.features
    labels = labels_of(baseline, frame, config, params)
    if baseline.space == "image":
        kept = features.kept[0]
        labels = labels_at(labels, features.u[0, kept], features.v[0, kept])
    return detections_of(frame, labels, config)
