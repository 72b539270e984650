"""The list of single hard cases, and what a review found an earlier default to do in each."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np

from benchmarks.paper import case_scenes
from jaxdet.sim import DepthSensor, Scene
from jaxdet.sim.appearance import POLISHED
from jaxdet.sim.draft import Draft

Asked = Literal["found", "drop", "level", "claimed"]
"""found: each thing is; drop: the step down is reported; level: no step down is reported; claimed:
how much free floor lies inside outlines."""
Changes = tuple[tuple[str, Any], ...]
"""Fields of :class:`jaxdet.sim.SimConfig`."""
STEEP: Changes = (("camera_height_m", 1.2), ("camera_pitch_rad", float(np.radians(35))))
BOWED: Changes = (("sensor", DepthSensor(noise_px=3 * DepthSensor().noise_px, bow=0.03)),)
HOLES: dict[str, Changes] = {
    "pixels": (("sensor", DepthSensor(speckle=0.6)),),
    "blotches": (("sensor", DepthSensor(dropout=0.6)),),
}
PANES = {"glass with holes": 0.4, "a clear pane": 0.0}
WALL_GAPS_CM = (0, 5, 10, 20)


class Case(NamedTuple):
    """A case."""

    group: str
    key: str
    title: str
    build: Callable[[Draft], Scene]
    review: str = ""
    """What the review says of it: found of its scenes, or in words."""
    asked: Asked = "found"
    within_m: float = np.inf
    """A detection that is this far nearer or farther than its thing does not find it [m]."""
    shown: Literal["", "width_error_m", "iou"] = ""
    """A measure of the things found."""
    least_pixels: int = 1
    """Things that show fewer pixels are not asked for."""
    changes: Changes = ()


LOW: dict[tuple[int, float], dict[float, str]] = {
    (30, 5.5): {1.0: "8 of 8", 2.0: "6 of 8", 3.0: "0 of 8"},
    (30, 6.0): {1.0: "8 of 8", 2.0: "8 of 8", 3.0: "0 of 8"},
    (30, 7.0): {1.0: "all", 2.0: "all", 3.0: "7 of 8", 3.5: "4 of 8"},
    (30, 8.0): {1.0: "all", 2.0: "all", 3.0: "8 of 8", 3.5: "5 of 8"},
    (30, 10.0): {1.0: "all", 2.0: "all", 3.0: "8 of 8", 3.5: "8 of 8"},
    (15, 8.0): {2.5: "3 of 4", 3.0: "0 of 4"},
    (15, 10.0): {2.5: "4 of 4", 3.0: "0 of 4"},
    (15, 15.0): {2.5: "4 of 4", 3.0: "3 of 4"},
}
"""By side and height of a box [cm], by distance [m]."""
GAPS: dict[tuple[float, int], dict[int, str]] = {
    (2.0, 30): {5: "none", 10: "none", 15: "none", 20: "all", 30: "all"},
    (3.0, 80): {5: "none", 10: "none", 15: "all", 20: "all", 30: "all"},
}
"""By distance [m] and height [cm] of two boxes, by the gap between them [cm]."""
BEFORE_WALL: dict[tuple[int | None, float], tuple[str, ...]] = {
    (40, 2.5): ("0 of 4", "4 of 4", "4 of 4", "4 of 4"),
    (40, 3.5): ("0 of 4", "0 of 4", "0 of 4", "4 of 4"),
    (20, 3.5): ("0 of 4", "0 of 4", "0 of 4", "2 of 4"),
    (None, 2.5): ("", "", "", ""),
    (None, 3.5): ("0 of 4", "0 of 4", "2 of 4", "4 of 4"),
}
"""By side of a cube [cm], None for a person, and distance of the wall [m]; by gap."""
HOLED = {
    ("approach", "pixels"): "12 of 12",
    ("approach", "blotches"): "12 of 12",
    ("mixed", "pixels"): "46 (49 without holes)",
    ("mixed", "blotches"): "45 of 53, 7 pieces",
    ("low_things", "pixels"): "15 (16 without holes)",
    ("low_things", "blotches"): "10 of 16",
}
CORRIDORS = {1.2: "57-65 %", 1.6: "21-40 %", 2.0: "31-33 %", 2.4: ""}
"""By width [m], with noise and bow."""


def _small_things() -> Iterator[Case]:
    for width, x in product((2, 3, 4, 6), (1.0, 2.0, 3.0)):
        build = partial(case_scenes.pole, width_m=width / 100, x=x)
        key, title = f"pole.{width}cm.{x:g}m", f"pole of {width} cm at {x:g} m"
        review = "all, width error <= 0.9 cm"
        yield Case("1 Poles", key, title, build, review, shown="width_error_m")
    for (side, tall), cells in LOW.items():
        for x, review in cells.items():
            size = side / 100, side / 100, tall / 100
            build = partial(case_scenes.box, size=size, near=x)
            name = f"{side}x{side}x{tall:g}"
            title = f"box {name} cm at {x:g} m"
            yield Case("2 Low boxes", f"low.{name}.{x:g}m", title, build, review)


def _near_others() -> Iterator[Case]:
    for (x, tall), reviews in GAPS.items():
        for gap, review in reviews.items():
            build = partial(case_scenes.two_boxes, tall_m=tall / 100, near=x, gap_m=gap / 100)
            title = f"two boxes {tall} cm high at {x:g} m, {gap} cm apart"
            yield Case("3 Gaps", f"gap.{gap}cm.{x:g}m", title, build, review)
    for (side, far), reviews in BEFORE_WALL.items():
        for gap, review in zip(WALL_GAPS_CM, reviews, strict=True):
            name, side_m = (f"box {side} cm", side / 100) if side else ("person", None)
            build = partial(case_scenes.before_wall, side_m=side_m, far=far, gap_m=gap / 100)
            key = f"wall.{name.replace(' ', '_')}.{gap}cm.{far:g}m"
            title = f"{name}, {gap} cm before a wall at {far:g} m"
            yield Case("4 Before a wall", key, title, build, review)


def _plates() -> Iterator[Case]:
    group = "5 Slabs and tables"
    for base in (40, 72):
        size, name = (0.6, 1.0, 0.04), f"slab {base} cm up at 2.2 m"
        build = partial(case_scenes.box, size=size, near=2.2, base=base / 100, name="slab")
        yield Case(group, f"slab.{base}cm", name, build, "found, IoU .47-.85", shown="iou")
    for kind in ("table", "round_table"):
        title = f"{kind.replace('_', ' ')} at 2.2 m"
        build = partial(case_scenes.table, kind=kind)
        yield Case(group, kind, title, build, "two pieces", shown="iou")


def _white() -> Iterator[Case]:
    for light, side, x, review in (
        ("normal", 30, 2.0, "found"),
        ("normal", 12, 2.5, "found"),
        ("strong", 12, 1.5, "found, width -25 cm"),
        ("strong", 12, 2.5, "missed (no depth)"),
    ):
        build = partial(case_scenes.white_box, side_m=side / 100, near=x)
        key, title = (
            f"white.{light}.{side}cm.{x:g}m",
            f"cube of {side} cm at {x:g} m, {light} light",
        )
        changes = (("light", light),)
        group = "6 White on white"
        yield Case(group, key, title, build, review, shown="width_error_m", changes=changes)


def _steps() -> Iterator[Case]:
    group = "7 Steps down"
    for deep, start in product((5, 10, 15, 20, 40), (1.0, 1.5, 2.0, 2.5)):
        build = partial(case_scenes.step_down, deep_m=deep / 100, start_m=start)
        key, title = f"drop.{deep}cm.{start:g}m", f"step of {deep} cm down at {start:g} m"
        yield Case(group, key, title, build, "nothing says so", "drop")
    for name, floor in (("any", None), ("polished", POLISHED)):
        build = partial(case_scenes.level_floor, floor=floor)
        title = f"{name} floor without a step, camera as a D435: none reported"
        changes = (("depth_error", 1.0),)
        yield Case(group, f"no_drop.{name}", title, build, asked="level", changes=changes)


def _others() -> Iterator[Case]:
    title = "box, 10 cm box and post, 13 cm apart sideways and 30 forward"
    review, group = "joined, outline x8.4", "8 Camera at 1.2 m, 35° down"
    yield Case(group, "steep", title, case_scenes.three_things, review, changes=STEEP)
    bodies = {"across": (0.42, 1.7, 0.22), "lengthwise": (1.7, 0.42, 0.22)}
    for x, (way, size) in product((1.5, 2.5), bodies.items()):
        build = partial(case_scenes.lying, size=size, near=x)
        title = f"body of 170x42x22 cm lying {way} at {x:g} m"
        review = "found, 2 pieces" if (x, way) == (2.5, "lengthwise") else "found"
        yield Case("9 A person lying", f"lying.{way}.{x:g}m", title, build, review)
    for (family, kind), review in HOLED.items():
        build = partial(case_scenes.drawn, family=family)
        key, title, group = f"holes.{family}.{kind}", f"family {family}, {kind}", "10 60 % holes"
        yield Case(group, key, title, build, review, least_pixels=400, changes=HOLES[kind])


def _walls_and_panes() -> Iterator[Case]:
    for wide, (name, changes) in product(CORRIDORS, {"clean": (), "bowed": BOWED}.items()):
        build = partial(case_scenes.corridor, wide_m=wide)
        told = "3x noise, 3 % bow" if changes else "clean camera"
        key, title = f"corridor.{wide:g}m.{name}", f"corridor of {wide:g} m, {told}"
        review = CORRIDORS[wide] if changes else "0-30 %"
        group = "11 Corridors: free floor inside outlines"
        yield Case(group, key, title, build, review, "claimed", changes=changes)
    for title, holes in PANES.items():
        changes = (("sensor", DepthSensor(pane_holes=holes)),)
        group, key, text = "12 Glass", f"glass.{holes:g}", f"{title} at 2 m, a box 1 m behind"
        build, review = case_scenes.pane, "not found"
        yield Case(group, key, text, build, review, within_m=0.3, changes=changes)


GROUPS = (_small_things, _near_others, _plates, _white, _steps, _others, _walls_and_panes)
CASES = {case.key: case for group in GROUPS for case in group()}
"""All cases by key, in the order of the review."""
