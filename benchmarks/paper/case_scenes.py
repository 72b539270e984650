"""Scenes of single hard cases: one or a few objects at given positions in a hall.

Every scene is made by a :class:`jaxdet.sim.draft.Draft`: floor, walls, lamp and appearance differ
by seed, and positions by centimetres.
"""

import numpy as np

from jaxdet.sim import Scene, make_scene
from jaxdet.sim.appearance import (
    CARTON,
    CLEAR_GLASS,
    INDOOR_FLOORS,
    POST,
    WHITE_BOX,
    Texture,
    pick,
    tinted,
)
from jaxdet.sim.draft import Draft, inner_wall, room
from jaxdet.sim.mesh import shift
from jaxdet.sim.models import build_model
from jaxdet.sim.scene import Box, Cylinder, Ground, Model, Wall

HALL_M = (3.5, 3.5, 7.0)
"""Distances of the walls to the left, right and ahead in cases without walls: out of range [m]."""
WHITE = Texture("plain", color=(238, 238, 236), grain=0.5)
CLOTHES = Texture("cloth", color=(70, 84, 120), accent=(44, 50, 66), size_m=0.2)
Size = tuple[float, float, float]
"""Size forward, sideways and upward [m]."""


def hall(
    draft: Draft,
    *walls: Wall,
    floor: Texture | None = None,
    look: Texture | None = None,
    ground: Ground | None = None,
) -> Scene:
    """Return the scene of a draft, in a hall or in front of walls."""
    around = walls or room(look or inner_wall(draft.rng), *HALL_M)
    return draft.enclosed("case", around, floor or pick(draft.rng, *INDOOR_FLOORS), ground)


def _put_box(
    draft: Draft,
    size: Size,
    near: float,
    y: float,
    look: Texture | None = None,
    base: float = 0.0,
    name: str = "box",
) -> None:
    """Return a box with its near face at ``near``."""
    plain = Texture("plain", tinted(draft.rng, (150, 140, 130), 40))
    chosen = look or pick(draft.rng, CARTON, WHITE_BOX, plain)
    draft.boxes.append(Box((near + size[0] / 2, y), size, 0.0, chosen, base, name))


def _aside(draft: Draft) -> float:
    return float(draft.rng.uniform(-0.15, 0.15))


def pole(draft: Draft, width_m: float, x: float) -> Scene:
    """Return a scene with a pole of 1 m."""
    look = pick(draft.rng, POST, Texture("plain", tinted(draft.rng, (150, 150, 150), 50)))
    post = Cylinder((x, _aside(draft)), width_m / 2, 1.0, look, name="pole")
    draft.cylinders.append(post)
    return hall(draft)


def box(draft: Draft, size: Size, near: float, base: float = 0.0, name: str = "box") -> Scene:
    """Return a scene with a box, or with a slab above the floor."""
    _put_box(draft, size, near, _aside(draft), base=base, name=name)
    return hall(draft)


def two_boxes(draft: Draft, tall_m: float, near: float, gap_m: float) -> Scene:
    """Return a scene with two boxes of 30 x 30 cm, side by side."""
    middle = _aside(draft)
    for side in (-1, 1):
        _put_box(draft, (0.3, 0.3, tall_m), near, middle + side * (gap_m / 2 + 0.15))
    return hall(draft)


def before_wall(draft: Draft, side_m: float | None, far: float, gap_m: float) -> Scene:
    """Return a scene with a cube, or a person (None), in front of a wall across the path."""
    back = far - gap_m
    if side_m is None:
        seed = int(draft.rng.integers(1 << 30))
        mesh = build_model("person", seed).moved(shift(yaw=np.pi))
        x = back - float(mesh.corners[..., 0].max())
        draft.models.append(Model("person", (x, _aside(draft)), float(np.pi), seed))
    else:
        _put_box(draft, (side_m, side_m, side_m), back - side_m, _aside(draft))
    look = inner_wall(draft.rng)
    return hall(draft, Wall((far + 0.05, -5.0), (far + 0.05, 5.0), 2.8, 0.1, look, "wall"))


def table(draft: Draft, kind: str) -> Scene:
    """Return a scene with a table, its long side ahead."""
    draft.put(kind, 2.2, _aside(draft), float(np.pi / 2 + draft.rng.normal(0, 0.2)))
    return hall(draft)


def white_box(draft: Draft, side_m: float, near: float) -> Scene:
    """Return a scene with a white cube on a white floor in front of white walls."""
    _put_box(draft, (side_m, side_m, side_m), near, _aside(draft), WHITE)
    return hall(draft, floor=WHITE, look=WHITE)


def step_down(draft: Draft, deep_m: float, start_m: float) -> Scene:
    """Return a scene with a step down across the path."""
    return hall(draft, ground=Ground(drop_m=deep_m, drop_start_m=start_m))


def level_floor(draft: Draft, floor: Texture | None) -> Scene:
    """Return a scene with a box on a floor without a step."""
    _put_box(draft, (0.3, 0.3, 0.4), 2.0, _aside(draft))
    return hall(draft, floor=floor)


def three_things(draft: Draft) -> Scene:
    """Return a scene with a box, a small box and a post, 13 cm apart sideways and 30 cm forward."""
    y = _aside(draft)
    _put_box(draft, (0.3, 0.3, 0.3), 1.5, y)
    _put_box(draft, (0.1, 0.1, 0.1), 2.1, y - 0.15 - 0.13 - 0.05, name="small box")
    place = 1.2 - 0.045, y + 0.15 + 0.13 + 0.045
    draft.cylinders.append(Cylinder(place, 0.045, 0.8, POST, name="post"))
    return hall(draft)


def lying(draft: Draft, size: Size, near: float) -> Scene:
    """Return a scene with a person lying on the floor."""
    _put_box(draft, size, near, _aside(draft), CLOTHES, name="person")
    return hall(draft)


def drawn(draft: Draft, family: str) -> Scene:
    """Return a scene of a family of the simulator."""
    return make_scene(family, int(draft.rng.integers(1 << 30)))


def corridor(draft: Draft, wide_m: float) -> Scene:
    """Return an empty corridor along the path."""
    right, look = wide_m * float(draft.rng.uniform(0.4, 0.6)), inner_wall(draft.rng)
    return hall(draft, *room(look, wide_m - right + 0.05, right + 0.05, 8.0))


def pane(draft: Draft) -> Scene:
    """Return a scene with a box behind a pane of glass."""
    _put_box(draft, (0.02, 1.2, 2.0), 2.0, _aside(draft), CLEAR_GLASS, name="pane")
    _put_box(draft, (0.4, 0.4, 0.5), 3.0, _aside(draft), name="box behind")
    return hall(draft)
