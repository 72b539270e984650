"""Family of crowded scenes: furniture at walls, and groups of objects that stand close together."""

import numpy as np

from jaxdet.sim.appearance import Texture, tinted
from jaxdet.sim.draft import Draft, building, hard_floor, inner_wall, room
from jaxdet.sim.scene import Cylinder, Model, Scene
from jaxdet.sim.terrain import place_low

GAPS_M = (0.03, 0.3)
"""Minimum and maximum gap between neighbours in a group [m]."""
LITTLE = {
    "small box": 0.12,
    "brick": 0.13,
    "bottle": 0.05,
    "cup": 0.06,
    "bowl": 0.12,
    "cable_drum": 0.16,
    "book": 0.18,
    "bag": 0.28,
}
"""Small objects, with the radii of the circles that contain them [m]."""
LARGE = {
    "small box": 0.12,
    "bottle": 0.05,
    "bowl": 0.12,
    "box": 0.3,
    "bin": 0.28,
    "bucket": 0.18,
    "chair": 0.35,
    "cone": 0.2,
    "person": 0.28,
    "pole": 0.08,
    "office_chair": 0.38,
    "plant": 0.35,
    "bag": 0.28,
    "cart": 0.5,
}
"""Objects of all sizes, in the same way."""
FURNITURE = {"desk": 0.8, "rack": 0.55, "bed": 1.1, "sofa": 0.9, "round_table": 0.6}
"""Pieces of furniture, in the same way."""


def crowded(draft: Draft) -> Scene:
    """Draw one to three groups: of small objects, or of all sizes with furniture in a room."""
    rng = draft.rng
    little, outdoors = bool(rng.random() < 0.5), bool(rng.random() < 0.15)
    for kind in rng.choice(list(FURNITURE), 0 if little or outdoors else int(rng.integers(0, 3))):
        draft.add_object(str(kind), *draft.place(1.4, 3.6, FURNITURE[str(kind)], gap=0.1))
    for _ in range(int(rng.integers(1, 4))):
        _group(draft, LITTLE if little else LARGE)
    left, right, front = rng.uniform((1.2, 1.2, 1.8), (3.5, 3.5, 5.0)).tolist()
    walls = building(rng) if outdoors else room(inner_wall(rng), left, right, front)
    return draft.enclosed("crowded", walls, hard_floor(rng, outdoors=outdoors))


def _group(draft: Draft, radii: dict[str, float]) -> None:
    """Place three to six objects, each next to another one of the group."""
    rng = draft.rng
    first, *kinds = (str(kind) for kind in rng.choice(list(radii), int(rng.integers(3, 7))))
    group = [(*draft.place(0.9, 3.2, radii[first], gap=0.1), radii[first])]
    _put(draft, first, *group[0][:2])
    for kind in kinds:
        for _ in range(30):
            x, y, radius = group[int(rng.integers(len(group)))]
            way, reach = float(rng.uniform(-np.pi, np.pi)), radius + radii[kind]
            reach += float(rng.uniform(*GAPS_M))
            x, y = x + reach * float(np.cos(way)), y + reach * float(np.sin(way))
            if x > 0.8 and all(np.hypot(x - a, y - b) > radii[kind] + r for a, b, r in draft.taken):
                draft.taken.append((x, y, radii[kind]))
                group.append((x, y, radii[kind]))
                _put(draft, kind, x, y)
                break


def _put(draft: Draft, kind: str, x: float, y: float) -> None:
    rng = draft.rng
    if kind in ("small box", "brick", "bottle", "cable_drum"):
        place_low(draft, kind, x, y)
    elif kind == "cup":
        radius, height = rng.uniform((0.035, 0.07), (0.06, 0.16)).tolist()
        texture = Texture("plain", tinted(rng, (150, 150, 150), 60), gloss=0.3)
        draft.cylinders.append(Cylinder((x, y), radius, height, texture, name="cup"))
    elif kind == "bowl":
        turn, seed = float(rng.uniform(-np.pi, np.pi)), int(rng.integers(1 << 30))
        scale = float(rng.uniform(0.3, 0.6))
        draft.models.append(Model("bucket", (x, y), turn, seed, scale, name="bowl"))
    else:
        draft.add_object(kind, x, y)
