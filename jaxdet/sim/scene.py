"""Scene description: floor, boxes, cylinders, models, walls, light and the robot's path.

The world frame follows ROS: x forward, y left, z up, metres; the floor is z = 0. All classes are
frozen dataclasses, so that scenes can be compared, hashed, and written as TOML or JSON.
"""

from dataclasses import dataclass, field

import numpy as np

from jaxdet.errors import ConfigError
from jaxdet.sim.appearance import Color, Texture

MAX_OBSTACLES = 255
"""Maximum number of objects: their numbers are stored in a byte, and 0 is the floor."""


@dataclass(frozen=True)
class Box:
    """An upright box."""

    center: tuple[float, float]
    """x, y of its centre [m]."""
    size: tuple[float, float, float]
    """Length along its x axis, width along its y axis, height [m]."""
    yaw: float = 0.0
    """Rotation about the vertical, counter-clockwise from above [rad]."""
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
    """Radius [m]."""
    height: float
    """Height [m]."""
    texture: Texture = field(default_factory=Texture)
    base: float = 0.0
    """Height of its underside above the floor [m]."""
    name: str = "cylinder"


@dataclass(frozen=True)
class Wall:
    """A wall between two points on the floor; not counted as an obstacle."""

    start: tuple[float, float]
    """x, y of one end [m]."""
    end: tuple[float, float]
    """x, y of the other end [m]."""
    height: float = 2.5
    """Height [m]."""
    thickness: float = 0.1
    """Thickness [m]."""
    texture: Texture = field(default_factory=Texture)
    name: str = "wall"

    @property
    def box(self) -> Box:
        """Box of the same shape."""
        a, b = np.asarray(self.start), np.asarray(self.end)
        x, y = ((a + b) / 2).tolist()
        dx, dy = (b - a).tolist()
        size = (float(np.hypot(dx, dy)), self.thickness, self.height)
        return Box((x, y), size, float(np.arctan2(dy, dx)), self.texture, name=self.name)


@dataclass(frozen=True)
class Light:
    """Direction of the lamp or the sun; ``SimConfig.light`` sets the brightness."""

    direction: tuple[float, float, float] = (-0.45, 0.35, 0.82)
    """Direction towards the lamp in the world; above the floor."""


@dataclass(frozen=True)
class Ground:
    """Shape of the floor: level, a ramp, bumps, steps down."""

    slope_rad: float = 0.0
    """Slope of the ramp [rad], negative downhill."""
    slope_start_m: float = 0.8
    """Start of the ramp along ``slope_yaw`` from the origin [m]; if the ramp starts far behind the
    robot, the robot stands on it."""
    slope_length_m: float = 200.0
    """Length of the ramp, after which the floor is level [m]."""
    slope_yaw: float = 0.0
    """Direction in which the ramp rises, counter-clockwise from x [rad]."""
    bump_m: float = 0.0
    """Maximum height and depth of bumps [m]."""
    bump_size_m: float = 0.8
    """Approximate wavelength of bumps [m]."""
    seed: int = 0
    """Seed of the bumps."""
    drop_m: float = 0.0
    """Height of a step down [m]; large for the end of the floor."""
    drop_start_m: float = 2.0
    """Position of the first step, along ``slope_yaw`` from the origin [m]."""
    drop_steps: int = 1
    """Number of steps down, each of ``drop_m``."""
    drop_tread_m: float = 0.3
    """Distance between steps [m]."""

    def __post_init__(self) -> None:
        if self.drop_m < 0 or self.drop_steps < 1 or self.drop_tread_m <= 0:
            raise ConfigError(
                "drop_m, drop_steps or drop_tread_m is out of range",
                remedy="use drop_m >= 0, drop_steps >= 1, drop_tread_m > 0",
            )

    @property
    def edges_m(self) -> tuple[float, ...]:
        """Positions of the steps, along ``slope_yaw`` from the origin [m]."""
        steps = range(self.drop_steps if self.drop_m else 0)
        return tuple(self.drop_start_m + k * self.drop_tread_m for k in steps)


@dataclass(frozen=True)
class Path:
    """A sine that the robot follows back and forth, so that a log can have any length.

    In the frame given by ``start`` and ``yaw`` the sine is y = weave sin(2 pi x / weave_length).
    """

    start: tuple[float, float] = (0.0, 0.0)
    """x, y of the start [m]."""
    yaw: float = 0.0
    """Direction of the line [rad]."""
    length: float = 2.0
    """Length of the line, after which the motion reverses [m]; 0: no motion."""
    speed: float = 0.5
    """Maximum speed along the line [m/s]."""
    weave: float = 0.0
    """Lateral amplitude [m]."""
    weave_length: float = 3.0
    """Wavelength [m]."""
    lead_s: float = 0.0
    """Time between the start of the motion and the first frame [s]."""


@dataclass(frozen=True)
class Model:
    """A procedural model of :mod:`jaxdet.sim.models`."""

    kind: str
    """Kind of model: person, walker, vehicle, barrier, cone, bucket, bin, tree_trunk, ..."""
    center: tuple[float, float] = (2.0, 0.0)
    """x, y of its middle [m]."""
    yaw: float = 0.0
    """Direction it faces, counter-clockwise from x [rad]."""
    seed: int = 0
    """Seed of its dimensions, colours and pose."""
    scale: float = 1.0
    """Scale factor."""
    path: Path | None = None
    """Path in the world, instead of ``center`` and ``yaw``; the model turns around at the ends."""
    name: str = ""
    """Name in the ground truth; empty: the kind."""


SceneObject = Box | Cylinder | Model | Wall
"""Any object on the floor."""


@dataclass(frozen=True)
class Scene:
    """Objects, floor, light and the robot's path.

    The number of an object is its index in ``boxes + cylinders + models + walls``, from 1.
    """

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
    """Colour of pixels without a hit."""

    def __post_init__(self) -> None:
        if len(self.objects) > MAX_OBSTACLES:
            raise ConfigError(
                f"scene {self.name!r} has {len(self.objects)} objects, more than {MAX_OBSTACLES}",
                remedy="remove objects",
            )

    @property
    def objects(self) -> tuple[SceneObject, ...]:
        """All objects on the floor; object ``i`` has the number ``i + 1``."""
        return (*self.boxes, *self.cylinders, *self.models, *self.walls)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the objects; a model without a name is named after its kind."""
        return tuple(o.name or o.kind if isinstance(o, Model) else o.name for o in self.objects)

    @property
    def moves(self) -> bool:
        """Whether any object moves."""
        return any(model.path is not None for model in self.models)


def rotation_z(yaw: float) -> np.ndarray:
    """Return the rotation matrix ``(2, 2)`` by ``yaw``, counter-clockwise [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])
