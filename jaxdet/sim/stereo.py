"""Parameters of a stereo depth camera, and the appearance of surfaces in it."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True)
class DepthSensor:
    """A stereo depth camera; the defaults are a D435's."""

    enabled: bool = True
    """Simulate errors; off: exact depths, rounded to units."""
    baseline_m: float = 0.05
    """Baseline [m]: 50 mm by the D400 series data sheet (337029)."""
    noise_px: float = 0.08
    """Standard deviation of the disparity [pixel]: 0.032 at best, 0.08 in practice according to
    RealSense's chief technical officer (librealsense issue 3904)."""
    noise_size_px: float = 1.5
    """Correlation length of the noise [pixel], as matching compares windows."""
    step_px: float = 1 / 32
    """Quantisation of the disparity [pixel]: Intel white paper "Subpixel linearity improvement"."""
    max_disparity_px: float = 126.0
    """Disparity search range [pixel], which sets the minimum depth f B / 126: Intel's guide to
    tuning D400 cameras."""
    max_range_m: float = 10.0
    """Maximum range [m], by the data sheet."""
    dropout: float = 0.004
    """Fraction of the image without depth, in blotches (chosen by eye on real D435 images)."""
    blotch_px: int = 8
    """Size of the blotches [pixel]."""
    speckle: float = 0.001
    """Fraction of single pixels without depth (chosen by eye on real D435 images)."""
    fattening_px: float = 1.2
    """Mean edge fattening of foreground objects [pixel], half of the effective matching window
    (chosen by eye on real D435 images)."""
    contrast: float = 1.0
    """Minimum ratio of contrast to noise for a match; 0: low contrast causes no holes."""
    projector_lux: float = 500.0
    """Ambient light that equals the brightness of the projector's dots at 1 m [lux]: about 0.36 W
    on 2 m2 in dots of a tenth of the area, with 3-4 W/m2 per klx."""
    bow: float = 0.0
    """Relative depth error at 4 m in the image corners, from a disparity error that is smooth and
    constant for a camera (stereo bowing)."""
    waves_px: float = 0.0
    """Standard deviation [pixel] of a smooth disparity error that differs from frame to frame; its
    wavelength is a fortieth of the image width."""
    margin: float = 0.0
    """Width of the margins with larger errors, at the left and right of the image, as a fraction of
    the image width."""
    margin_bend_px: float = 0.0
    """Maximum disparity error at the outer end of a margin [pixel], constant for a camera; if it is
    positive, depth is too small, so that a floor bends up."""
    margin_dropout: float = 0.0
    """Fraction of the margins without depth, in blotches."""
    reflection: float = 0.0
    """Fraction of a mirroring floor that shows the depth of the mirror image, below the floor, at
    grazing angles; multiplied by the floor's gloss."""
    pane_holes: float = 0.4
    """Fraction of a clear pane without depth, in blotches; the rest shows the background."""

    def with_errors(self, scale: float = 1.0) -> "DepthSensor":
        """Return the sensor with the additional errors of real D400 cameras on real floors.

        At ``scale`` 1, holes, deviations from the floor plane by distance, and errors in the
        margins are as in labelled frames of a D415 (``python -m benchmarks.real_floor``).

        Args:
            scale: Scale of the errors, 0 or more; noise grows by half per unit.
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
    """Appearance of the surfaces in the depth camera."""

    reflectance: np.ndarray
    """Reflectance ``(H, W)`` float32, 0 to 1."""
    gloss: np.ndarray
    """Gloss ``(H, W)`` float32, 0 to 1."""
    facing: np.ndarray
    """Cosine between surface normal and view, ``(H, W)`` float32."""
    lux: float
    """Ambient light [lux]."""
    mirrored: np.ndarray | None = None
    """z of the mirror image in a floor, ``(H, W)`` float64 [m]; inf where it is empty, NaN outside
    of mirroring floors."""
    behind: np.ndarray | None = None
    """z behind a clear pane, ``(H, W)`` float64 [m]; inf without a hit, NaN outside of
    panes."""
