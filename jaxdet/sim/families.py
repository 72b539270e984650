"""Families of random scenes: the paper's four, those of the paper's experiments, and others.

The robot stands at the origin and looks along x. In most scenes objects are farther apart than the
default lateral gap, but not in all, as close objects matter too.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxdet.sim import indoors, terrain
from jaxdet.sim.apart import apart
from jaxdet.sim.appearance import POST, Texture, pick
from jaxdet.sim.crowded import crowded
from jaxdet.sim.draft import Draft
from jaxdet.sim.moving import moving
from jaxdet.sim.scene import Cylinder, Model, Path, Scene

DISTANCES_M = (3.0, 2.5, 2.0, 1.5, 1.25, 1.0)
"""Distances of the paper's Table 4 [m]."""
CYLINDER_RADIUS_M = 0.045
"""Radius of the paper's cylinder (Section 4.4) [m]."""
_APPROACHED = ("person", "cone", "bucket", "tree_trunk", "chair", "bin", "box", "pole")


def _people_and_vehicle(draft: Draft, distance_m: float) -> Scene:
    del distance_m
    rng = draft.rng
    x, y = float(rng.uniform(3.6, 5.0)), float(rng.uniform(-1.6, 1.6))
    draft.put("vehicle", x, y, float(rng.choice([np.pi / 2, -np.pi / 2]) + rng.normal(0, 0.25)))
    draft.taken.append((x, y, 0.9))
    for _ in range(int(rng.integers(1, 4))):
        draft.put("person" if rng.random() < 0.5 else "walker", *draft.place(1.4, 3.2, 0.28))
    return draft.finish("people_and_vehicle", outdoors=True)


def _roadblocks(draft: Draft, distance_m: float) -> Scene:
    del distance_m
    rng = draft.rng
    x, gap = float(rng.uniform(2.2, 3.4)), float(rng.uniform(1.7, 2.3))
    for k in range(int(rng.integers(1, 3))):
        y = (k - 0.5) * gap + float(rng.normal(0, 0.15))
        place = x + float(rng.normal(0, 0.25)), y
        draft.put("barrier", *place, float(rng.normal(0, 0.25)))
        draft.taken.append((*place, 0.75))
    for _ in range(int(rng.integers(2, 5))):
        draft.put("cone", *draft.place(1.2, 3.6, 0.2))
    return draft.finish("roadblocks", outdoors=True)


def _bucket(draft: Draft, distance_m: float) -> Scene:
    del distance_m
    for _ in range(int(draft.rng.integers(1, 4))):
        draft.put("bucket", *draft.place(1.0, 3.0, 0.18))
    if draft.rng.random() < 0.5:
        draft.add_object(str(draft.rng.choice(["bin", "box"])), *draft.place(1.8, 3.6, 0.3))
    return draft.finish("bucket", outdoors=bool(draft.rng.random() < 0.3))


def _tree_trunk(draft: Draft, distance_m: float) -> Scene:
    del distance_m
    for _ in range(int(draft.rng.integers(1, 4))):
        draft.put("tree_trunk", *draft.place(1.3, 3.8, 0.25))
    if draft.rng.random() < 0.3:
        draft.put("street_light", *draft.place(1.5, 3.8, 0.15))
    return draft.finish("tree_trunk", outdoors=True)


def _mixed(draft: Draft, distance_m: float) -> Scene:
    del distance_m
    kinds = [
        "person", "walker", "barrier", "cone", "bucket", "bin", "tree_trunk", "street_light",
        "table", "chair", "box", "pole", "brick", "kerb",
    ]  # fmt: skip
    radii = {"barrier": 0.7, "table": 0.7, "person": 0.28, "walker": 0.35, "chair": 0.3}
    for _ in range(int(draft.rng.integers(3, 7))):
        kind = str(draft.rng.choice(kinds))
        draft.add_object(kind, *draft.place(1.1, 4.0, radii.get(kind, 0.25)))
    return draft.finish("mixed", outdoors=bool(draft.rng.random() < 0.5))


def _cylinder(draft: Draft, distance_m: float) -> Scene:
    y = float(draft.rng.uniform(-0.15, 0.15) * distance_m)
    texture = pick(
        draft.rng, POST, Texture("plain", (196, 198, 200)), Texture("plain", (60, 62, 66))
    )
    x = float(np.sqrt(distance_m**2 - y**2))
    draft.cylinders.append(Cylinder((x, y), CYLINDER_RADIUS_M, 1.0, texture, name="cylinder"))
    return draft.finish("cylinder", outdoors=bool(draft.rng.random() < 0.5), clutter=False)


def _approach(draft: Draft, distance_m: float) -> Scene:
    """Draw an obstacle, floor and lamp that depend only on the seed, not on the distance.

    All obstacles fit into the view at 1 m, which tables and barriers don't.
    """
    kind, aside = str(draft.rng.choice(_APPROACHED)), float(draft.rng.uniform(-0.08, 0.08))
    draft.add_object(kind, distance_m, aside * distance_m)
    return draft.finish("approach", outdoors=bool(draft.rng.random() < 0.5), clutter=False)


def _queue(draft: Draft, distance_m: float) -> Scene:
    del distance_m
    rng = draft.rng
    start, way = draft.place(1.5, 2.2, 0.3), float(rng.uniform(0.15, 1.2) * rng.choice([-1, 1]))
    x, y = start
    for _ in range(int(rng.integers(3, 6))):
        draft.put("person", x, y, way + np.pi + float(rng.normal(0, 0.2)))
        step = float(rng.uniform(0.65, 0.95))
        x, y = x + step * np.cos(way), y + step * np.sin(way)
    return draft.finish("queue", outdoors=bool(rng.random() < 0.4))


def _low_things(draft: Draft, distance_m: float) -> Scene:
    del distance_m
    rng = draft.rng
    kinds = ["brick", "plank", "cable", "book", "kerb", "bottle"]
    for kind in rng.choice(kinds, int(rng.integers(2, 5)), replace=False):
        draft.add_object(str(kind), *draft.place(0.9, 2.4, 0.25))
    return draft.finish("low_things", outdoors=bool(rng.random() < 0.5))


def _pedestrian(draft: Draft, distance_m: float) -> Scene:
    """Draw a person who walks to and fro across the path of the moving robot (paper, Fig. 15)."""
    del distance_m
    rng = draft.rng
    draft.add_object("bin", 3.6, float(rng.uniform(0.9, 1.3)))
    draft.add_object("box", 4.2, -float(rng.uniform(0.9, 1.3)))
    path = Path((float(rng.uniform(2.8, 3.4)), -1.3), np.pi / 2 + 0.15, 2.6, 1.2)
    draft.models.append(Model("walker", seed=int(rng.integers(1 << 30)), path=path, name="person"))
    scene = draft.finish("pedestrian", outdoors=False)
    return replace(scene, path=Path(length=1.6, speed=0.4, weave=0.05))


def _fixed(draw: Callable[[Draft], Scene]) -> Callable[[Draft, float], Scene]:
    return lambda draft, distance_m: draw(draft)


_HARD: dict[str, Callable[[Draft], Scene]] = {
    "corridor": indoors.corridor,
    "wall_in_range": indoors.wall_in_range,
    "room": indoors.furnished,
    "low_clutter": terrain.low_clutter,
    "drops": terrain.drops,
    "ramps": terrain.ramps,
    "tables": indoors.tables,
}
HARD_FAMILIES = tuple(_HARD)
"""Names of the harder families: walls in range, low objects, steps down, ramps; floors that are
plain or reflect."""
_FAMILIES: dict[str, Callable[[Draft, float], Scene]] = {
    "people_and_vehicle": _people_and_vehicle,
    "roadblocks": _roadblocks,
    "bucket": _bucket,
    "tree_trunk": _tree_trunk,
    "mixed": _mixed,
    "cylinder": _cylinder,
    "approach": _approach,
    "queue": _queue,
    "low_things": _low_things,
    "pedestrian": _pedestrian,
    **{name: _fixed(draw) for name, draw in _HARD.items()},
    "moving": _fixed(moving),
    "crowded": _fixed(crowded),
}
FAMILIES = tuple(_FAMILIES)
"""Names of all families."""


def make_scene(family: str, seed: int, distance_m: float = 2.0) -> Scene:
    """Draw a scene without intersecting solid objects.

    Args:
        family: One of ``FAMILIES``.
        seed: Random seed.
        distance_m: Distance of the obstacle of ``cylinder`` and ``approach`` [m].
    """
    return apart(draw_scene(family, seed, distance_m), seed)


def draw_scene(family: str, seed: int, distance_m: float = 2.0) -> Scene:
    """Draw a scene without :func:`jaxdet.sim.apart.apart`: objects may intersect."""
    return _FAMILIES[family](Draft(seed, family), distance_m)
