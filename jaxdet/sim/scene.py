"""What a simulated world consists of: a floor, boxes, cylinders, models, walls, light, a path.

The world frame is ROS's: x forward, y left, z up, metres; the floor is z = 0. Everything is a
frozen dataclass, so a scene can be compared, hashed, and written as TOML or JSON.
"""

from dataclasses import dataclass, field

import numpy as np

from jaxdet.errors import ConfigError
from jaxdet.sim.looks import Color, Texture

MAX_OBSTACLES = 255
"""Obstacle numbers are stored in a byte, and 0 is the floor."""


@dataclass(frozen=True)
class Box:
    """An upright box, turned about the vertical."""

    center: tuple[float, float]
    """x, y of its centre [m]."""
    size: tuple[float, float, float]
    """Length along its own x, width along its own y, height [m]."""
    yaw: float = 0.0
    """Turn, counter-clockwise from above [rad]."""
    texture: Texture = field(default_factory=Texture)
    base: float = 0.0
    """Height of its underside above the floor [m]."""
    name: str = "box"


@dataclass(frozen=True)
class Cylinder:
    """An upright cylinder: a post, a bin, a bucket."""

    center: tuple[float, float]
    """x, y of its axis [m]."""
    radius: float
    """[m]."""
    height: float
    """[m]."""
    texture: Texture = field(default_factory=Texture)
    base: float = 0.0
    """Height of its underside above the floor [m]."""
    name: str = "cylinder"


@dataclass(frozen=True)
class Wall:
    """A wall from one point of the floor to another; no obstacle to be found, but in the way."""

    start: tuple[float, float]
    """x, y of one end [m]."""
    end: tuple[float, float]
    """x, y of the other end [m]."""
    height: float = 2.5
    """[m]."""
    thickness: float = 0.1
    """[m]."""
    texture: Texture = field(default_factory=Texture)
    name: str = "wall"

    @property
    def box(self) -> Box:
        """The same body as a box."""
        a, b = np.asarray(self.start), np.asarray(self.end)
        x, y = ((a + b) / 2).tolist()
        dx, dy = (b - a).tolist()
        size = (float(np.hypot(dx, dy)), self.thickness, self.height)
        return Box((x, y), size, float(np.arctan2(dy, dx)), self.texture, name=self.name)


@dataclass(frozen=True)
class Light:
    """One lamp, or the sun, beside an even light; how bright is the log's (``SimConfig.light``)."""

    direction: tuple[float, float, float] = (-0.45, 0.35, 0.82)
    """Towards the lamp, in the world; above the floor."""


@dataclass(frozen=True)
class Ground:
    """The floor's shape: level, a ramp, bumps, steps down."""

    slope_rad: float = 0.0
    """Rise of the ramp [rad], negative goes down."""
    slope_start_m: float = 0.8
    """Where the ramp begins, along ``slope_yaw`` from the origin [m]; far behind the robot, the
    robot stands on it."""
    slope_length_m: float = 200.0
    """How long it is; level again after it [m]."""
    slope_yaw: float = 0.0
    """Direction in which it rises, counter-clockwise from x [rad]."""
    bump_m: float = 0.0
    """Greatest height and depth of bumps [m]."""
    bump_size_m: float = 0.8
    """About how long a bump and the hollow after it are [m]."""
    seed: int = 0
    """Where the bumps are."""
    drop_m: float = 0.0
    """How far the floor steps down [m]; a floor that ends is a great one."""
    drop_start_m: float = 2.0
    """Where it does, along ``slope_yaw`` from the origin [m]."""
    drop_steps: int = 1
    """Number of steps down, each by ``drop_m``: stairs."""
    drop_tread_m: float = 0.3
    """From one of them to the next [m]."""

    def __post_init__(self) -> None:
        if self.drop_m < 0 or self.drop_steps < 1 or self.drop_tread_m <= 0:
            raise ConfigError(
                "the floor's steps go down, and there is at least one",
                remedy="use drop_m >= 0, drop_steps >= 1, drop_tread_m > 0",
            )

    @property
    def edges_m(self) -> tuple[float, ...]:
        """Where the floor steps down, along ``slope_yaw`` from the origin [m]."""
        steps = range(self.drop_steps if self.drop_m else 0)
        return tuple(self.drop_start_m + k * self.drop_tread_m for k in steps)


@dataclass(frozen=True)
class Path:
    """A weaving line that the robot follows forth and back, so a log can have any length.

    In the frame of ``start`` and ``yaw`` the line is y = weave sin(2 pi x / weave_length).
    """

    start: tuple[float, float] = (0.0, 0.0)
    """x, y of the robot at the beginning [m]."""
    yaw: float = 0.0
    """Direction of the line [rad]."""
    length: float = 2.0
    """How far it goes before it comes back [m]; 0: stands still."""
    speed: float = 0.5
    """Greatest speed along the line [m/s]."""
    weave: float = 0.0
    """Sideways amplitude [m]."""
    weave_length: float = 3.0
    """Length of one weave [m]."""
    lead_s: float = 0.0
    """How long it has been under way at the first frame [s]."""


@dataclass(frozen=True)
class Model:
    """A procedural model of :mod:`jaxdet.sim.models`."""

    kind: str
    """Its name: person, walker, vehicle, barrier, cone, bucket, bin, tree_trunk, ..."""
    center: tuple[float, float] = (2.0, 0.0)
    """x, y of its middle [m]."""
    yaw: float = 0.0
    """Where it faces, counter-clockwise from x [rad]."""
    seed: int = 0
    """Its dimensions, colours and pose."""
    scale: float = 1.0
    """Its size against the drawn one."""
    path: Path | None = None
    """Where it moves, in the world, instead of ``center`` and ``yaw``; it turns about at the
    ends."""
    name: str = ""
    """Its name in the truth; empty: its kind."""


Thing = Box | Cylinder | Model | Wall
"""What stands on the floor."""


@dataclass(frozen=True)
class Scene:
    """A world; the obstacle number of an object is its place in ``boxes + cylinders + models +
    walls``, from 1."""  # noqa: D205, D209

    name: str = "scene"
    boxes: tuple[Box, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    models: tuple[Model, ...] = ()
    walls: tuple[Wall, ...] = ()
    floor: Texture = field(default_factory=Texture)
    ground: Ground = field(default_factory=Ground)
    light: Light = field(default_factory=Light)
    path: Path = field(default_factory=Path)
    background: Color = (205, 210, 215)
    """Seen where nothing is hit."""

    def __post_init__(self) -> None:
        if len(self.objects) > MAX_OBSTACLES:
            raise ConfigError(
                f"the scene {self.name!r} has {len(self.objects)} objects",
                remedy=f"use at most {MAX_OBSTACLES}",
            )

    @property
    def objects(self) -> tuple[Thing, ...]:
        """All that stands on the floor; object ``i`` has the number ``i + 1``."""
        return (*self.boxes, *self.cylinders, *self.models, *self.walls)

    @property
    def names(self) -> tuple[str, ...]:
        """The objects' names; a model that has none has its kind's."""
        return tuple(o.name or o.kind if isinstance(o, Model) else o.name for o in self.objects)

    @property
    def moves(self) -> bool:
        """Whether any object does."""
        return any(model.path is not None for model in self.models)


def rotation_z(yaw: float) -> np.ndarray:
    """The rotation ``(2, 2)`` by ``yaw`` counter-clockwise [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])
