"""Families of scenes with walls and furniture in range of the camera."""

import numpy as np

from jaxdet.sim.appearance import (
    CARTON,
    CLEAR_GLASS,
    DOOR,
    HEDGE,
    STEEL,
    WHITE_BOX,
    WOOD,
    Texture,
    pick,
    tinted,
)
from jaxdet.sim.draft import Draft, hard_floor, inner_wall, room
from jaxdet.sim.mesh import shift
from jaxdet.sim.models import build_model
from jaxdet.sim.scene import Box, Model, Scene, Wall, rotation_z

_HALF = 0.05
"""Half of a wall's thickness [m]."""
_BEFORE_WALLS = ("box", "box", "person", "bin", "cone", "bucket", "chair", "cable_drum")


def _point(yaw: float, along: float, across: float) -> tuple[float, float]:
    """Return a point given in a frame rotated by ``yaw`` about the robot."""
    x, y = (rotation_z(yaw) @ (along, across)).tolist()
    return x, y


def corridor(draft: Draft) -> Scene:
    """Draw a corridor 1.2 to 2.4 m wide with one to three objects; some have a recessed door."""
    rng = draft.rng
    width, yaw = float(rng.uniform(1.2, 2.4)), float(rng.normal(0, 0.06))
    right = float(rng.uniform(0.3, 0.7)) * width
    left, end = width - right, float(rng.uniform(3.2, 11.0))
    texture = inner_wall(rng)
    recess = float(rng.uniform(1.3, 3.0)) if rng.random() < 0.5 else None
    walls = _side(yaw, 1, left, end, texture, recess if rng.random() < 0.5 else None)
    walls += _side(yaw, -1, right, end, texture, recess)
    closing = pick(rng, texture, texture, DOOR, CLEAR_GLASS)
    walls.append(_across(yaw, end, left, right, closing, "end"))
    if closing is CLEAR_GLASS:
        walls.append(_across(yaw, end + 2.5, left + 2, right + 2, texture, "beyond"))
    for _ in range(int(rng.integers(1, 4))):
        _object_in_corridor(draft, yaw, left, right, min(end - 0.4, 3.6))
    return draft.enclosed("corridor", tuple(walls), hard_floor(rng, outdoors=False))


def _across(yaw: float, x: float, left: float, right: float, texture: Texture, name: str) -> Wall:
    ends = _point(yaw, x + _HALF, -right - 0.1), _point(yaw, x + _HALF, left + 0.1)
    return Wall(*ends, 2.6, 2 * _HALF, texture, f"wall {name}")


def _side(
    yaw: float, sign: int, y: float, end: float, texture: Texture, recess: float | None
) -> list[Wall]:
    """Return the walls of one side of a corridor, with their face at ``y``.

    ``recess`` is the distance along the corridor at which a recessed door begins [m]; None: no
    door.
    """

    def piece(a: float, b: float, face: float, what: Texture, name: str) -> Wall:
        across = sign * (face + _HALF)
        return Wall(_point(yaw, a, across), _point(yaw, b, across), 2.6, 2 * _HALF, what, name)

    name = "wall left" if sign > 0 else "wall right"
    if recess is None:
        return [piece(-2.0, end + 0.1, y, texture, name)]
    deep, wide = 0.3, 0.95
    jambs = [
        Wall(_point(yaw, x, sign * y), _point(yaw, x, sign * (y + deep)), 2.6, 0.1, texture, name)
        for x in (recess - _HALF, recess + wide + _HALF)
    ]
    door = piece(recess, recess + wide, y + deep, DOOR, "wall door")
    before = piece(-2.0, recess, y, texture, name)
    return [before, door, *jambs, piece(recess + wide, end + 0.1, y, texture, name)]


def _object_in_corridor(draft: Draft, yaw: float, left: float, right: float, far: float) -> None:
    """Place an object in a corridor, at a wall or between the walls, if there is room for it."""
    rng = draft.rng
    kind = str(rng.choice(["box", "box", "person", "bin", "cone", "chair"]))
    radius = 0.22 if kind == "person" else 0.28
    for _ in range(40):
        along = float(rng.uniform(1.1, far))
        middle = float(rng.uniform(-right + radius, left - radius))
        side = float(rng.choice([left - radius, radius - right]))
        across = side - float(np.sign(side)) * float(rng.uniform(0.02, 0.2))
        across = across if rng.random() < 0.5 else middle
        x, y = _point(yaw, along, across)
        if all(np.hypot(x - a, y - b) > radius + r + 0.1 for a, b, r in draft.taken):
            draft.taken.append((x, y, radius))
            if kind == "box":
                size = rng.uniform((0.2, 0.2, 0.15), (0.4, 0.4, 0.6)).tolist()
                texture = pick(
                    rng, CARTON, WHITE_BOX, Texture("plain", tinted(rng, (150, 140, 130)))
                )
                turn = yaw + float(rng.normal(0, 0.2))
                draft.boxes.append(Box((x, y), (size[0], size[1], size[2]), turn, texture))
            else:
                draft.add_object(kind, x, y)
            return


def wall_in_range(draft: Draft) -> Scene:
    """Draw one to three objects 5 to 50 cm in front of a wall or hedge 1.5 to 3.5 m away."""
    rng = draft.rng
    far, yaw = float(rng.uniform(1.5, 3.5)), float(rng.normal(0, 0.2))
    hedge = bool(rng.random() < 0.3)
    thick, tall = (0.6, float(rng.uniform(0.6, 1.4))) if hedge else (0.1, 2.8)
    texture, name = (HEDGE, "hedge") if hedge else (inner_wall(rng), "wall")
    # The wall is rotated about the point of its face that is straight ahead of the robot.
    ahead, along = rotation_z(yaw).T
    face = np.array([far, 0.0])
    a, b = (tuple((face + ahead * thick / 2 + side * along).tolist()) for side in (-5.0, 5.0))
    wall = Wall((a[0], a[1]), (b[0], b[1]), tall, thick, texture, name)
    half = 0.40 * far
    slots = rng.permutation(np.linspace(-half, half, 3))[: int(rng.integers(1, 4))]
    for slot in slots:
        gap = float(rng.choice([rng.uniform(0.05, 0.2), rng.uniform(0.05, 0.5)]))
        _put_before(draft, face + (float(slot) + rng.normal(0, 0.05)) * along, ahead, gap)
    return draft.enclosed("wall_in_range", (wall,), hard_floor(rng, outdoors=hedge))


def _put_before(draft: Draft, face: np.ndarray, ahead: np.ndarray, gap: float) -> None:
    """Place an object in front of a wall.

    Args:
        draft: Scene to add to.
        face: Point on the face of the wall, ``(2,)`` [m].
        ahead: Unit vector into the wall, ``(2,)``.
        gap: Gap between object and wall [m].
    """
    rng = draft.rng
    kind, seed = str(rng.choice(_BEFORE_WALLS)), int(rng.integers(1 << 30))
    yaw = float(np.arctan2(ahead[1], ahead[0]) + rng.normal(0, 0.15))
    if kind == "box":
        size = rng.uniform((0.15, 0.15, 0.1), (0.45, 0.45, 0.6)).tolist()
        corners = (np.array([[1, 1], [1, -1]]) * size[:2] / 2) @ rotation_z(yaw).T
        x, y = (face - (gap + np.abs(corners @ ahead).max()) * ahead).tolist()
        texture = pick(rng, CARTON, WHITE_BOX, Texture("plain", tinted(rng, (150, 140, 130), 40)))
        draft.boxes.append(Box((x, y), (size[0], size[1], size[2]), yaw, texture))
        return
    mesh = build_model(kind, seed).moved(shift(yaw=yaw + np.pi))
    reach = float((mesh.corners.reshape(-1, 3)[:, :2] @ ahead).max())
    x, y = (face - (gap + reach) * ahead).tolist()
    draft.models.append(Model(kind, (x, y), yaw + np.pi, seed))


def furnished(draft: Draft) -> Scene:
    """Draw a room of 2.5 to 5 m with tables, chairs, cabinets, a sofa; some have a glass wall."""
    rng = draft.rng
    left, right, front = rng.uniform((1.1, 1.1, 2.6), (2.4, 2.4, 4.6)).tolist()
    texture = inner_wall(rng)
    walls = room(texture, left, right, front)
    if rng.random() < 0.25:
        pane = walls[1]
        back = Wall(
            (front + 2.0, -4.0), (front + 2.0, 4.0), 2.8, texture=texture, name="wall beyond"
        )
        clear = Wall(pane.start, pane.end, pane.height, 0.02, CLEAR_GLASS, "wall of glass")
        walls = (walls[0], clear, *walls[2:], back)
    for side in rng.permutation([-1, 0, 1])[: int(rng.integers(1, 3))].tolist():
        _by_wall(draft, side, left, right, front)
    if rng.random() < 0.6:
        kind = str(rng.choice(["table", "round_table"]))
        x, y = draft.place(1.7, max(front - 0.8, 1.9), 0.6, gap=0.1)
        draft.put(kind, x, y)
        for turn in rng.uniform(-np.pi, np.pi, int(rng.integers(0, 4))).tolist():
            place = x + 0.75 * float(np.cos(turn)), y + 0.75 * float(np.sin(turn))
            if place[0] > 0.9:
                draft.put("chair", *place, turn + np.pi + float(rng.normal(0, 0.3)))
    for _ in range(int(rng.integers(1, 4))):
        kind = str(rng.choice(["chair", "bin", "box", "bucket", "person", "pole"]))
        x, y = draft.place(1.1, max(front - 0.4, 1.5), 0.28, gap=0.15)
        draft.add_object(kind, x, float(np.clip(y, 0.35 - right, left - 0.35)))
    return draft.enclosed("room", walls, hard_floor(rng, outdoors=False))


def _by_wall(draft: Draft, side: int, left: float, right: float, front: float) -> None:
    """Place a cabinet or sofa with its back to a wall: -1 right, 0 ahead, 1 left."""
    rng = draft.rng
    cabinet = bool(rng.random() < 0.6)
    deep = float(rng.uniform(0.35, 0.6)) if cabinet else 0.95
    yaw = {0: np.pi, 1: -np.pi / 2, -1: np.pi / 2}[side]
    off = deep / 2 + _HALF + float(rng.choice([0.0, 0.02, 0.06]))
    x, y = front - off, float(rng.uniform(-0.5, 0.5) * (left + right) / 2)
    if side:
        x = float(rng.uniform(1.5, max(front - 1.0, 1.8)))
        y = left - off if side > 0 else off - right
    if cabinet:
        wide, tall = rng.uniform((0.5, 0.5), (1.4, 1.9)).tolist()
        texture = pick(rng, WOOD, STEEL, Texture("plain", tinted(rng, (200, 196, 188), 20)))
        draft.boxes.append(Box((x, y), (deep, wide, tall), yaw, texture, name="cabinet"))
        draft.taken.append((x, y, wide / 2))
    else:
        draft.put("sofa", x, y, yaw)
        draft.taken.append((x, y, 0.9))


def tables(draft: Draft) -> Scene:
    """Draw tables with legs or a column, and floating slabs."""
    rng = draft.rng
    for _ in range(int(rng.integers(1, 3))):
        x, y = draft.place(1.3, 3.2, 0.7, gap=0.1)
        kind = str(rng.choice(["table", "table", "round_table"]))
        scale = float(rng.choice([1.0, 1.0, 0.6]))
        turn, seed = float(rng.uniform(-np.pi, np.pi)), int(rng.integers(1 << 30))
        draft.models.append(Model(kind, (x, y), turn, seed, scale))
    if rng.random() < 0.6:
        x, y = draft.place(1.3, 3.0, 0.5, gap=0.1)
        size = rng.uniform((0.25, 0.5, 0.03), (0.7, 1.4, 0.3)).tolist()
        texture = pick(rng, WOOD, STEEL, Texture("plain", tinted(rng, (190, 186, 176), 25)))
        base, turn = float(rng.uniform(0.3, 0.8)), float(rng.normal(0, 0.5))
        shape = size[0], size[1], size[2]
        draft.boxes.append(Box((x, y), shape, turn, texture, base, "slab"))
    if rng.random() < 0.5:
        draft.add_object("chair", *draft.place(1.2, 3.2, 0.3, gap=0.1))
    left, right, front = rng.uniform((1.6, 1.6, 3.0), (4.0, 4.0, 7.0)).tolist()
    walls = room(inner_wall(rng), left, right, front)
    return draft.enclosed("tables", walls, hard_floor(rng, outdoors=False))
