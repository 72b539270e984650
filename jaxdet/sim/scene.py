"""What a simulated world consists of: a floor, boxes, cylinders, walls, light, a path.

The world frame is ROS's: x forward, y left, z up, metres; the floor is z = 0. Everything is a
frozen dataclass, so a scene can be compared, hashed, and written as TOML or JSON.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from jaxdet.errors import ConfigError

Color = tuple[int, int, int]
"""RGB, 0-255."""

MAX_OBSTACLES = 255
"""Obstacle numbers are stored in a byte, and 0 is the floor."""


@dataclass(frozen=True)
class Texture:
    """How a surface looks."""

    kind: Literal["plain", "noise", "tiles", "wood", "stripes", "checker", "carton"] = "plain"
    """Pattern drawn with the two colours."""
    color: Color = (150, 150, 150)
    """Main colour."""
    accent: Color = (90, 90, 90)
    """Colour of joints, stripes, prints."""
    size_m: float = 0.3
    """Period of the pattern [m]: tile, board, stripe pair, carton face."""
    grain: float = 3.0
    """Fine variation, standard deviation [grey levels]."""


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
    """One far lamp and an even background."""

    direction: tuple[float, float, float] = (-0.45, 0.35, 0.82)
    """Towards the lamp, in the world."""
    ambient: float = 0.55
    """Share of the surface's colour seen in the shade."""
    diffuse: float = 0.5
    """Share added where the lamp shines straight on it."""


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


@dataclass(frozen=True)
class Scene:
    """A world; the obstacle number of an object is its place in ``boxes + cylinders + walls``,
    from 1."""  # noqa: D205, D209

    name: str = "scene"
    boxes: tuple[Box, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    walls: tuple[Wall, ...] = ()
    floor: Texture = field(default_factory=Texture)
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
    def objects(self) -> tuple[Box | Cylinder | Wall, ...]:
        """All that stands on the floor; object ``i`` has the number ``i + 1``."""
        return (*self.boxes, *self.cylinders, *self.walls)

    @property
    def solids(self) -> tuple[Box | Cylinder, ...]:
        """The objects, walls as boxes."""
        return (*self.boxes, *self.cylinders, *(wall.box for wall in self.walls))


def rotation_z(yaw: float) -> np.ndarray:
    """The rotation ``(2, 2)`` by ``yaw`` counter-clockwise [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])


def footprint(solid: Box | Cylinder, sides: int = 16) -> np.ndarray:
    """Where a solid meets the floor seen from above.

    Args:
        solid: The solid.
        sides: Corners of the polygon that stands for a circle (inscribed).

    Returns:
        ``(4, 2)`` or ``(sides, 2)`` float64, counter-clockwise, world [m].
    """
    if isinstance(solid, Box):
        half = np.array(solid.size[:2]) / 2
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
        return corners @ rotation_z(solid.yaw).T + solid.center
    angle = np.arange(sides) * (2 * np.pi / sides)
    return solid.radius * np.stack([np.cos(angle), np.sin(angle)], 1) + solid.center


def bounds(solid: Box | Cylinder) -> np.ndarray:
    """The corners ``(8, 3)`` of an upright box around a solid, world [m]: bottom, then top."""
    if isinstance(solid, Box):
        outline, height = footprint(solid), solid.size[2]
    else:
        side = 2 * solid.radius
        outline, height = footprint(Box(solid.center, (side, side, 0.0))), solid.height
    low = np.column_stack([outline, np.full(4, solid.base)])
    return np.concatenate([low, low + np.array([0, 0, height])])
