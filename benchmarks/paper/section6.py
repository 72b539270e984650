"""Section 6: influence of the depth interval, the robot's width and the Canny thresholds."""

from collections.abc import Sequence

import numpy as np

from benchmarks.paper.lab import Lab
from benchmarks.paper.plan import CANNY_BOUNDS, LIGHTS, SCENES
from benchmarks.paper.preset_frames import PresetFrames, with_settings
from benchmarks.paper.section import Section, percent
from jaxdet.eval import Tally, score
from jaxdet.presets import preset

GAPS_M = (0.05, 0.10, 0.15, 0.20, 0.40, 0.60)
"""Depth intervals d_z [m]."""
WIDTHS_M = (0.30, 0.40, 0.60)
"""Widths of robots [m]."""


def run(lab: Lab) -> Section:
    """Vary the parameters that Section 6 names: d_z, the robot's width and the Canny thresholds."""
    section = Section("section6", "Section 6: parameters and light")
    specs = [spec for i in LIGHTS for scene in SCENES for spec in lab.test_specs(scene, i)]
    frames = PresetFrames(lab.load(specs), preset("paper"))
    lights = np.array([shot.spec.light for shot in frames.shots])
    section.say(
        f"The preset paper on {len(lights)} test frames with one parameter changed at a time. "
        "According to the paper, a large depth interval groups obstacles together, and a small one "
        "divides objects into layers; in dim light there are fewer feature points, and a small "
        "interval reduces the success rate. A split is a second detection of an object, a merge a "
        "further object in a detection."
    )
    _gaps(section, frames, lights)
    _widths(section, frames)
    _bounds(section, frames, lights)
    return section


def _gaps(section: Section, frames: PresetFrames, lights: np.ndarray) -> None:
    rows: list[list[str]] = []
    for gap_m in GAPS_M:
        tallies = frames.tallies({"depth_gap_m": gap_m})
        every = score(tallies)
        key = f"gap.{gap_m:g}m"
        for name in ("splits", "merges"):
            section.add(f"{key}.{name}", float(getattr(every.tally, name)), "", "lower")
        cells = [f"{every.tally.splits:.0f}", f"{every.tally.merges:.0f}"]
        for light in LIGHTS:
            one = score(_chosen(tallies, lights == light))
            section.add(f"{key}.{light}.accuracy", one.accuracy, "", "higher")
            cells.append(f"{percent(one.accuracy)} ({percent(one.recall)})")
        rows.append([f"{gap_m:.2f}", *cells])
    header = ["d_z [m]", "Splits", "Merges", *(f"{light}: ACC (recall)" for light in LIGHTS)]
    section.table(header, rows)


def _widths(section: Section, frames: PresetFrames) -> None:
    rows: list[list[str]] = []
    for width_m in WIDTHS_M:
        truths, cells = frames.passable(width_m), []
        for name, params in (("chosen", {}), ("width", {"robot_width_m": width_m})):
            one = score(frames.tallies(params, truths=truths))
            section.add(f"robot.{width_m:g}m.{name}.accuracy", one.accuracy, "", "higher")
            splits, merges = one.tally.splits, one.tally.merges
            cells.append(f"{percent(one.accuracy)} ({splits:.0f}, {merges:.0f})")
        rows.append([f"{width_m:.2f}", *cells])
    section.table(
        ["Width of the robot [m]", "gaps of the preset", "both gaps equal to the width"],
        rows,
        "ACC (splits, merges) if objects that the robot can't pass between are one obstacle",
    )


def _bounds(section: Section, frames: PresetFrames, lights: np.ndarray) -> None:
    own = frames.config.features
    rows: list[list[str]] = []
    for low, high in ((int(own.canny_low), int(own.canny_high)), *CANNY_BOUNDS):
        params = {"canny_high": float(high)}
        features = frames.features(with_settings(frames.config, params).features)
        corners = np.concatenate([np.asarray(part.kept).sum(axis=1) for part in features])
        tallies = frames.tallies(params)
        cells = []
        for light in LIGHTS:
            count = float(np.median(corners[lights == light]))
            one = score(_chosen(tallies, lights == light))
            section.add(f"canny.{low}-{high}.{light}.corners", count, "", "info")
            section.add(f"canny.{low}-{high}.{light}.accuracy", one.accuracy, "", "higher")
            cells.append(f"{count:.0f}, {percent(one.accuracy)}")
        rows.append([f"{low}, {high}", *cells])
    header = ["Canny thresholds", *(f"{light}: corners, ACC" for light in LIGHTS)]
    section.table(header, rows, "Corners above the floor and in range, median per frame")


def _chosen(tallies: Sequence[Tally], which: np.ndarray) -> list[Tally]:
    return [tallies[k] for k in np.flatnonzero(which).tolist()]
