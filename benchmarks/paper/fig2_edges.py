"""Fig. 2: corners with and without Canny."""

from dataclasses import replace

import cv2
import numpy as np

from benchmarks.baselines import prepare
from benchmarks.paper.lab import Lab
from benchmarks.paper.pictures import encode, grid, titled
from benchmarks.paper.plan import SCENES
from benchmarks.paper.section import Section, percent
from benchmarks.paper.shots import Shot, frames_of
from jaxdet.config import Config
from jaxdet.presets import preset
from jaxdet.render import canvas
from jaxdet.types import Features

CONTOUR_PX = 3
"""A corner this near to an object's edge in the truth is on the contour."""


def run(lab: Lab) -> Section:
    """Fig. 2 (Shi-Tomasi on grey, and on the Canny edges) as picture and counts."""
    section = Section("fig2", "Fig. 2: features with and without Canny")
    base = preset("paper")
    configs = {
        "without": replace(base, features=replace(base.features, canny=False)),
        "with": base,
    }
    shots = [shot for scene in SCENES for shot in lab.load(lab.test_specs(scene, "normal")[:4])]
    section.say(
        f"Shi-Tomasi corners with the preset paper (no mask) on the grey image and on the Canny "
        f"edges, {len(shots)} simulated frames in normal light. A corner is on a contour when it "
        f"lies within {CONTOUR_PX} pixels of an object's edge in the truth. The paper shows two "
        "pictures and no counts."
    )
    rows: list[list[str]] = []
    for name, config in configs.items():
        counts = np.array([_counts(shot, _features(shot, config)) for shot in shots])
        shares = counts[:, 1:].sum(axis=0) / counts[:, 0].sum()
        section.add(f"{name}.features", float(counts[:, 0].mean()), "", "info")
        for part, share in zip(("contour", "inside", "background"), shares, strict=True):
            section.add(f"{name}.{part}", float(share), "", "info")
        title = f"{name} Canny"
        rows.append([title, f"{counts[:, 0].mean():.0f}", *(percent(s) for s in shares)])
    header = ["", "Corners a frame", "on contours", "inside objects", "on floor and background"]
    section.table(header, rows)
    for shot in (shots[0], shots[-1]):
        views = [_view(shot, config, f"{n} Canny") for n, config in configs.items()]
        caption = f"Fig. 2: {shot.title}; all corners before any are dropped."
        section.picture(shot.spec.family, encode(grid(views, 2)), caption)
    return section


def _features(shot: Shot, config: Config) -> Features:
    return prepare(frames_of([shot]), config)[0].features


def _counts(shot: Shot, features: Features) -> tuple[int, int, int, int]:
    """Corners: all, on contours, inside objects, elsewhere."""
    solid = np.concatenate([[False], ~shot.truth.is_wall])
    number = shot.truth.obstacle_id[0].astype(np.uint8)
    shown = np.where(solid[number], number, 0).astype(np.uint8)
    kernel = np.ones((3, 3), np.uint8)
    edge = (cv2.dilate(shown, kernel) != cv2.erode(shown, kernel)).astype(np.uint8)
    near = cv2.dilate(edge, np.ones((2 * CONTOUR_PX - 1,) * 2, np.uint8)) > 0
    valid = features.valid[0]
    u, v = features.u[0, valid], features.v[0, valid]
    contour = near[v, u]
    inside = ~contour & (shown[v, u] > 0)
    return len(u), int(contour.sum()), int(inside.sum()), int((~contour & ~inside).sum())


def _view(shot: Shot, config: Config, title: str) -> np.ndarray:
    features = _features(shot, config)
    image = shot.color.copy()
    valid = features.valid[0]
    spots = np.stack([features.u[0, valid], features.v[0, valid]], axis=1)
    canvas.dots(image, spots, (80, 214, 120), 1.8)
    return titled(image, f"{title}: {len(spots)} corners", 520)
