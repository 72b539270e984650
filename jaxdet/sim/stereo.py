"""A stereo depth camera by its figures, and what it sees beside distances."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True)
class DepthSensor:
    """A stereo depth camera; the defaults are a D435's."""

    enabled: bool = True
    """Off: exact depths, only rounded to units."""
    baseline_m: float = 0.05
    """Between the imagers [m]: 50 mm by the D400 series data sheet (337029)."""
    noise_px: float = 0.08
    """Standard deviation of a disparity [pixel]: 0.032 at best, 0.08 to be reckoned with, by
    RealSense's chief technical officer (librealsense issue 3904)."""
    noise_size_px: float = 1.5
    """How far the noise hangs together [pixel]: matching compares windows, not pixels."""
    step_px: float = 1 / 32
    """Step of a disparity [pixel]: Intel white paper "Subpixel linearity improvement"."""
    max_disparity_px: float = 126.0
    """Search range [pixel], which sets the nearest depth f B / 126: Intel's guide to
    tuning D400 cameras."""
    max_range_m: float = 10.0
    """Nothing farther is delivered [m]: the data sheet's usable range."""
    dropout: float = 0.004
    """Share of the image in blotches without depth (our choice, by eye on real D435 images)."""
    blotch_px: int = 8
    """How far the blotches hang together [pixel]."""
    speckle: float = 0.001
    """Share of single pixels without depth (as above)."""
    fattening_px: float = 1.2
    """How far nearer things grow over what is behind them [pixel]: half of what of the matching
    window decides (our choice, by eye on real D435 images)."""
    contrast: float = 1.0
    """Least contrast over noise that is matched; 0: no holes of that cause."""
    projector_lux: float = 500.0
    """Light of the day against which the projector's dots at 1 m are as bright as it [lux]: about
    0.36 W on 2 m2 in dots of a tenth of the area, against 500 lx of 3-4 W/m2 each klx."""
    bow: float = 0.0
    """Share of the depth by which it is off at 4 m in the image's corners, by an error of the
    disparity that is smooth in the image and always the same for a camera."""
    waves_px: float = 0.0
    """Standard deviation of an error of the disparity in waves of a fortieth of the image's width
    [pixel], another one in each frame."""
    margin: float = 0.0
    """Width of the bad bands at the left and right of the image, as a share of its width."""
    margin_bend_px: float = 0.0
    """Greatest error of the disparity at the outer end of such a band [pixel], always the same for
    a camera; positive is too near, so a floor bends up."""
    margin_dropout: float = 0.0
    """Share of the bands without depth, in blotches."""
    reflection: float = 0.0
    """Share of a mirroring floor that shows the depth of what it mirrors, as things below the
    floor, where it is seen at a grazing angle; times the floor's gloss."""
    pane_holes: float = 0.4
    """Share of a clear pane, in blotches, that has no depth; the rest shows what is behind."""

    def with_errors(self, scale: float = 1.0) -> "DepthSensor":
        """The sensor with what real D400 cameras show on real floors and a clean one doesn't.

        At ``scale`` 1 floors have the holes, the spread about their plane by distance and the
        bent margins of a D415's labelled frames (``python -m benchmarks.real_floor``).

        Args:
            scale: How much of it is added, 0 or more; noise grows by half of its size each.
        """
        return replace(
            self,
            noise_px=self.noise_px * (1 + 0.5 * scale),
            bow=self.bow + 0.05 * scale,
            waves_px=self.waves_px + 0.12 * scale,
            dropout=min(self.dropout + 0.04 * scale, 0.9),
            blotch_px=self.blotch_px if scale == 0 else max(self.blotch_px, 14),
            margin=self.margin if scale == 0 else max(self.margin, 0.11),
            margin_bend_px=self.margin_bend_px + 5.0 * scale,
            margin_dropout=min(self.margin_dropout + 0.4 * scale, 0.9),
            reflection=min(self.reflection + 0.5 * scale, 1.0),
        )


D435_LIKE = DepthSensor().with_errors()
"""A D435 on a real floor."""


class Surface(NamedTuple):
    """What the depth camera sees beside distances."""

    reflectance: np.ndarray
    """``(H, W)`` float32, 0 to 1."""
    gloss: np.ndarray
    """``(H, W)`` float32, 0 to 1."""
    facing: np.ndarray
    """``(H, W)`` float32, cosine between surface and view."""
    lux: float
    """Light of the day."""
    mirrored: np.ndarray | None = None
    """``(H, W)`` float64, z of what a mirroring floor mirrors [m], inf where that is nothing, NaN
    where there is no such floor."""
    behind: np.ndarray | None = None
    """``(H, W)`` float64, z of what is behind a clear pane [m], inf where that is nothing, NaN
    where there is no pane."""
