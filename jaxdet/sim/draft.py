"""Random scenes: placement of objects, floor, lamp and walls."""

import numpy as np

from jaxdet.sim.appearance import (
    CARTON,
    CONCRETE,
    DARK_CASE,
    HARD_FLOORS,
    HEDGE,
    INDOOR_FLOORS,
    OUTDOOR_FLOORS,
    PAINT,
    POST,
    RED_CRATE,
    WALLS,
    WET,
    WHITE_BOX,
    Texture,
    pick,
    tinted,
)
from jaxdet.sim.scene import Box, Cylinder, Ground, Light, Model, Path, Scene, Wall

_STANDING = Path(length=0.0)


class Draft:
    """A random scene under construction."""

    def __init__(self, seed: int, family: str) -> None:
        self.rng = np.random.default_rng([seed, *family.encode()])
        self.models: list[Model] = []
        self.boxes: list[Box] = []
        self.cylinders: list[Cylinder] = []
        self.taken: list[tuple[float, float, float]] = []

    def put(self, kind: str, x: float, y: float, yaw: float | None = None) -> None:
        """Place a model, with a random yaw by default."""
        turn = float(self.rng.uniform(-np.pi, np.pi)) if yaw is None else yaw
        self.models.append(Model(kind, (x, y), turn, int(self.rng.integers(1 << 30))))

    def place(
        self, near: float, far: float, radius: float, gap: float = 0.45
    ) -> tuple[float, float]:
        """Draw a position in the field of view, ``gap`` [m] from other objects if there is room.

        Otherwise the gap is 5 cm, or objects may overlap.
        """
        x, y = 0.0, 0.0
        for attempt in range(120):
            x = float(self.rng.uniform(near, far))
            half = max(0.42 * x - 0.5 * radius, 0.1)
            y = float(self.rng.uniform(-half, half))
            clear = radius + (gap if attempt < 60 else 0.05)
            if all(np.hypot(x - a, y - b) > clear + r for a, b, r in self.taken):
                break
        self.taken.append((x, y, radius))
        return x, y

    def box(self, x: float, y: float) -> None:
        """Place a box or case of 0.2-0.6 m."""
        size = self.rng.uniform((0.2, 0.2, 0.15), (0.5, 0.5, 0.6)).tolist()
        texture = pick(self.rng, CARTON, CARTON, DARK_CASE, RED_CRATE, WHITE_BOX)
        yaw = float(self.rng.uniform(-0.8, 0.8))
        self.boxes.append(Box((x, y), (size[0], size[1], size[2]), yaw, texture))

    def pole(self, x: float, y: float, radius: float) -> None:
        """Place a pole, plain or striped."""
        plain = Texture("plain", tinted(self.rng, (150, 150, 150), 50))
        height = float(self.rng.uniform(0.8, 1.6))
        texture = pick(self.rng, POST, plain)
        self.cylinders.append(Cylinder((x, y), radius, height, texture, name="pole"))

    def add_object(self, kind: str, x: float, y: float) -> None:
        """Place an object of a kind, given by its name."""
        if kind == "box":
            self.box(x, y)
        elif kind == "pole":
            self.pole(x, y, float(self.rng.uniform(0.015, 0.08)))
        else:
            facing = kind in ("barrier", "table", "vehicle", "plank", "cable", "kerb")
            self.put(kind, x, y, float(self.rng.normal(0, 0.35)) if facing else None)

    def _clutter(self, *, outdoors: bool, far: float) -> None:
        """Place objects in front of the far wall, or a hedge: visible, but out of range."""
        rng = self.rng
        if outdoors:
            x, y = rng.uniform((4.6, -1.5), (6.5, 1.5)).tolist()
            size = (0.6, float(rng.uniform(2, 5)), float(rng.uniform(0.6, 1.3)))
            yaw = float(rng.normal(0, 0.2))
            self.boxes.append(Box((x, y), size, yaw, HEDGE, name="hedge"))
            return
        for y in rng.uniform(-2.2, 2.2, int(rng.integers(1, 5))).tolist():
            self.add_object(str(rng.choice(["box", "box", "bin", "chair"])), far - 0.5, y)

    def finish(self, family: str, *, outdoors: bool, clutter: bool = True) -> Scene:
        """Return the scene with floor, lamp, and walls or a far building.

        Args:
            family: Name of the scene.
            outdoors: Whether to use an outdoor floor and a building instead of a hall.
            clutter: Whether to allow far objects or a hedge.
        """
        rng = self.rng
        walls = building(rng) if outdoors else _hall(rng)
        if clutter and rng.random() < 0.5:
            self._clutter(outdoors=outdoors, far=walls[1].start[0] if not outdoors else 6.0)
        floor = pick(rng, *(OUTDOOR_FLOORS if outdoors else INDOOR_FLOORS))
        light = self._lamp()
        bumps = Ground(bump_m=float(rng.choice([0.0, 0.0, 0.006])), seed=int(rng.integers(1000)))
        return self._scene(family, walls, floor, bumps if outdoors else Ground(), light)

    def enclosed(
        self, family: str, walls: tuple[Wall, ...], floor: Texture, ground: Ground | None = None
    ) -> Scene:
        """Return the scene with the given walls, texture and shape of the floor, and a lamp."""
        return self._scene(family, walls, floor, ground or Ground(), self._lamp())

    def _lamp(self) -> Light:
        way, lift = self.rng.uniform(0, 2 * np.pi), self.rng.uniform(0.75, 1.25)
        lamp = (float(np.cos(way) * np.cos(lift)), float(np.sin(way) * np.cos(lift)))
        return Light((*lamp, float(np.sin(lift))))

    def _scene(
        self, family: str, walls: tuple[Wall, ...], floor: Texture, ground: Ground, light: Light
    ) -> Scene:
        objects = tuple(self.boxes), tuple(self.cylinders), tuple(self.models)
        return Scene(family, *objects, walls, floor, ground, light, _STANDING)


def hard_floor(rng: np.random.Generator, *, outdoors: bool) -> Texture:
    """Draw a floor's texture; half of the floors (outdoors a third) are plain or reflective."""
    if outdoors:
        return pick(rng, *OUTDOOR_FLOORS, WET, CONCRETE)
    return pick(rng, *HARD_FLOORS) if rng.random() < 0.5 else pick(rng, *INDOOR_FLOORS)


def inner_wall(rng: np.random.Generator) -> Texture:
    """Draw the texture of an indoor wall, plain paint with a probability of 2 / 5."""
    return pick(rng, *WALLS, PAINT, PAINT)


def room(texture: Texture, left: float, right: float, front: float) -> tuple[Wall, ...]:
    """Return four walls around the robot at these distances [m]; their names begin with wall."""
    back = -3.0
    corners = [(back, -right), (front, -right), (front, left), (back, left)]
    pairs = zip(corners, [*corners[1:], corners[0]], strict=True)
    return tuple(
        Wall(a, b, 2.8, texture=texture, name=f"wall {i}") for i, (a, b) in enumerate(pairs)
    )


def _hall(rng: np.random.Generator) -> tuple[Wall, ...]:
    left, right, front = rng.uniform((2.4, 2.4, 5.0), (4.5, 4.5, 8.0)).tolist()
    return room(pick(rng, *WALLS), left, right, front)


def building(rng: np.random.Generator) -> tuple[Wall, ...]:
    """Return the front of a building, out of range."""
    far, turn = float(rng.uniform(9, 14)), float(rng.normal(0, 1.5))
    texture = pick(rng, *WALLS)
    return (Wall((far + turn, -14.0), (far - turn, 14.0), 6.0, 0.3, texture, name="building"),)
