"""Fig. 2: corners with and without Canny."""

import cv2
import numpy as np

from benchmarks.paper.lab import Lab
from benchmarks.paper.pictures import encode, grid, titled
from benchmarks.paper.plan import SCENES
from benchmarks.paper.section import Section, percent
from benchmarks.paper.shots import Shot
from benchmarks.paper.timing import in_turns
from jaxdet.presets import preset
from jaxdet.reference.paper._canny import canny, grey
from jaxdet.render import canvas

CONTOUR_PX = 3
"""Maximum distance of corners on a contour from the true edge of an object [pixel]."""


def run(lab: Lab) -> Section:
    """Fig. 2 (Shi-Tomasi on grey, and on the Canny edges) as picture and counts."""
    section = Section("fig2", "Fig. 2: features with and without Canny")
    ways = {"without": False, "with": True}
    shots = [shot for scene in SCENES for shot in lab.load(lab.test_specs(scene, "normal")[:4])]
    section.say(
        "Shi-Tomasi corners on the grey image and on the Canny edges, with the settings of the "
        f"preset paper, in {len(shots)} simulated frames in normal light. A corner is on a contour "
        f"if it is within {CONTOUR_PX} pixels of the true edge of an object. The paper shows two "
        "pictures and gives no counts."
    )
    rows: list[list[str]] = []
    for name, on_edges in ways.items():
        counts = np.array([_counts(shot, _corners(shot, on_edges)) for shot in shots])
        shares = counts[:, 1:].sum(axis=0) / counts[:, 0].sum()
        section.add(f"{name}.features", float(counts[:, 0].mean()), "", "info")
        for part, share in zip(("contour", "inside", "background"), shares, strict=True):
            section.add(f"{name}.{part}", float(share), "", "info")
        title = f"{name} Canny"
        rows.append([title, f"{counts[:, 0].mean():.0f}", *(percent(s) for s in shares)])
    header = ["", "Corners per frame", "on contours", "inside objects", "on floor and background"]
    section.table(header, rows)
    _time(section, shots)
    for shot in (shots[0], shots[-1]):
        views = [_view(shot, _corners(shot, way), f"{n} Canny") for n, way in ways.items()]
        caption = f"Fig. 2: {shot.title}; all corners, also those on the floor."
        section.picture(shot.spec.family, encode(grid(views, 2)), caption)
    return section


def _time(section: Section, shots: list[Shot]) -> None:
    """Add the times of Shi-Tomasi and of Harris, which is slower according to the paper."""
    config = preset("paper").features
    selection = config.max_corners, config.quality_level, config.min_distance
    images = [grey(shot.color) for shot in shots]
    functions = {
        name: lambda i, harris=harris: cv2.goodFeaturesToTrack(
            images[i], *selection, useHarrisDetector=harris
        )
        for name, harris in (("shi_tomasi", False), ("harris", True))
    }
    times = {name: float(np.median(ms)) for name, ms in in_turns(functions, len(images), 5).items()}
    for name, ms in times.items():
        section.add(f"{name}.time", ms, "ms", "info")
    section.say(
        f"On the grey images, Shi-Tomasi takes {times['shi_tomasi']:.1f} ms and Harris "
        f"{times['harris']:.1f} ms per frame (cv2.goodFeaturesToTrack, best of 5 in turns, median)."
    )


def _corners(shot: Shot, on_edges: bool) -> np.ndarray:
    """Return corners of the Canny edges or of the grey image, ``(n, 2)`` column and row."""
    config, image = preset("paper").features, grey(shot.color)
    if on_edges:
        image = canny(image, config.canny_low, config.canny_high)
    selection = config.max_corners, config.quality_level, config.min_distance
    return cv2.goodFeaturesToTrack(image, *selection)[:, 0].astype(np.int32)


def _counts(shot: Shot, corners: np.ndarray) -> tuple[int, int, int, int]:
    """Return the numbers of corners: all, on contours, inside objects, elsewhere."""
    solid = np.concatenate([[False], ~shot.truth.is_wall])
    number = shot.truth.obstacle_id[0].astype(np.uint8)
    shown = np.where(solid[number], number, 0).astype(np.uint8)
    kernel = np.ones((3, 3), np.uint8)
    edge = (cv2.dilate(shown, kernel) != cv2.erode(shown, kernel)).astype(np.uint8)
    near = cv2.dilate(edge, np.ones((2 * CONTOUR_PX - 1,) * 2, np.uint8)) > 0
    u, v = corners.T
    contour = near[v, u]
    inside = ~contour & (shown[v, u] > 0)
    return len(u), int(contour.sum()), int(inside.sum()), int((~contour & ~inside).sum())


def _view(shot: Shot, corners: np.ndarray, title: str) -> np.ndarray:
    image = shot.color.copy()
    canvas.dots(image, corners, (80, 214, 120), 1.8)
    return titled(image, f"{title}: {len(corners)} corners", 520)
