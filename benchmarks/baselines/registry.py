"""Baselines: their description, and functions that run one on a frame."""

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
    """Method that this project's method is compared with.

    Attributes:
        name: Key of the baseline.
        title: Name in a table.
        run: Function ``run(points, **params) -> labels``. In the spaces ``xz`` and ``xyz``, the
            points are the frame's features above the floor, ``(n, 2)`` or ``(n, 3)`` float64 in
            metres, n >= 2, and the labels ``(n,)`` integer, negative = noise. In the space
            ``frame``, it is ``run(frame, config, **params)`` with the same labels; in the space
            ``image``, ``run(frame, **params)`` with labels ``(H, W)``.
        space: Kind of input of ``run``, see ``run``.
        defaults: Value of each parameter for use without tuning.
        grid: Values with which :func:`benchmarks.baselines.tune` starts, by parameter.
        citation: Source of the method.
        needs: Modules that the method imports.
        sized: Whether ``run`` has an argument ``min_points``, the minimum size of clusters.
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
        """Reason why the baseline can't run here; None if it can."""
        for module in self.needs:
            try:
                import_module(module)
            except (ImportError, OSError) as error:
                return f"{self.title} needs {module}: {error}"
        return None

    def trials(self) -> list[dict[str, Any]]:
        """Return all combinations of the grid's values."""
        return [
            dict(zip(self.grid, values, strict=True)) for values in product(*self.grid.values())
        ]

    def numbers(self) -> list[str]:
        """Return the grid's parameters that are numbers and have several values."""
        return [
            name
            for name, values in self.grid.items()
            if len(values) > 1 and not isinstance(values[0], bool | str)
        ]


def labels_of(
    baseline: Baseline, frame: Frame, config: Config | None = None, params: Params | None = None
) -> np.ndarray:
    """Run a baseline on a frame without the minimum size of clusters; only this is timed.

    In the spaces ``xz`` and ``xyz``, the parameter ``depth_scale`` multiplies z before the method
    runs, because depth and lateral distance need different thresholds.

    Args:
        baseline: The method.
        frame: Frame, preprocessed as for jaxdet's method.
        config: Configuration; only the minimum size of clusters is used, by methods that have one.
        params: Parameters that replace the baseline's defaults.

    Returns:
        Labels ``(n,)`` int32 of the features above the floor; in the space ``image``, ``(H, W)``
        int32.
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
    """Detect the obstacles of a frame by a baseline.

    Args:
        baseline: The method.
        frame: Frame, preprocessed as for jaxdet's method.
        config: Configuration of the minimum size and the outlines.
        params: Parameters that replace the baseline's defaults.

    Returns:
        Obstacles, ``B = 1``.
    """
    config, features = config or Config(), frame.features
    labels = labels_of(baseline, frame, config, params)
    if baseline.space == "image":
        kept = features.kept[0]
        labels = labels_at(labels, features.u[0, kept], features.v[0, kept])
    return detections_of(frame, labels, config)
