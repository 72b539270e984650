"""Camera mounting, passed by the user as the prior of the floor."""

import math
from dataclasses import dataclass
from numbers import Real
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from jaxdet.arguments import number, numbers
from jaxdet.elementary import hypot
from jaxdet.errors import ConfigError, InputError
from jaxdet.floor.plane import flat_plane, plane_from_down, plane_from_transform
from jaxdet.types import GroundPlane, is_rigid

HIGHEST_M = 20.0
"""Upper bound of the camera height [m]."""


@dataclass(frozen=True)
class Mount:
    """Camera pose relative to the floor.

    Attributes:
        height_m: Mounting height: optical centre of the depth camera above the floor [m].
        pitch_rad: Downward tilt [rad]; negative looks up.
        roll_rad: Clockwise rotation about the optical axis seen from behind the camera [rad].

    Raises:
        ConfigError: The height is not between 0 and 20 m, or an angle is out of range.
    """

    height_m: float
    pitch_rad: float = 0.0
    roll_rad: float = 0.0

    def __post_init__(self) -> None:
        for name in ("height_m", "pitch_rad", "roll_rad"):
            value = getattr(self, name)
            if not isinstance(value, Real):
                got = repr(value[:40]) if isinstance(value, str) else type(value).__name__
                problem = f"expected a number in metres or radians, got {got}"
                raise ConfigError(problem, topic=name)
            try:
                float(value)
            except OverflowError as error:
                problem, remedy = "number is too large", "pass metres or radians"
                raise ConfigError(problem, topic=name, remedy=remedy) from error
        if not 0 < self.height_m < HIGHEST_M:
            raise ConfigError(
                f"camera height must be above 0 and below {HIGHEST_M:g} m, got {self.height_m:g} m",
                topic="height_m",
                remedy="pass the height in metres",
            )
        for name, most in (("pitch_rad", math.pi / 2), ("roll_rad", math.pi)):
            angle = getattr(self, name)
            if not abs(angle) <= most + 1e-9:
                raise ConfigError(
                    f"expected radians from {-most:.2f} to {most:.2f}, got {angle:g}",
                    topic=name,
                    remedy="convert degrees with math.radians",
                )

    @classmethod
    def from_gravity(cls, height_m: float, gravity: ArrayLike) -> Self:
        """Build a mount from the direction of gravity, for instance from the camera's IMU.

        Args:
            height_m: Mounting height [m].
            gravity: Direction of falling ``(3,)`` in the depth camera's optical frame (x right, y
                down, z forward), of any length. An accelerometer at rest measures the opposite.

        Raises:
            ConfigError: ``gravity`` is not a direction.

        Example:
            >>> Mount.from_gravity(0.5, [0.0, 9.81, 0.0])
            Mount(height_m=0.5, pitch_rad=0.0, roll_rad=0.0)
        """
        down = numbers("gravity", gravity, np.float64)
        length = float(hypot(hypot(*down[:2]), down[2])) if down.shape == (3,) else math.nan
        if not 0 < length < math.inf:
            problem = f"expected a direction, got shape {down.shape} and length {length:g}"
            raise ConfigError(problem, topic="gravity", remedy="pass three numbers, x y z")
        height = np.array([number("height_m", height_m)])
        return cls._of(plane_from_down(down[None] / length, height))

    @classmethod
    def from_transform(cls, T_base_camera: ArrayLike) -> Self:
        """Build a mount from the camera's pose on a robot whose base frame has z = 0 on the floor.

        Args:
            T_base_camera: Transform ``(4, 4)`` from the camera optical frame to the base [m].

        Raises:
            InputError: The matrix is not a rigid transform.
            ConfigError: The camera is not between 0 and 20 m above the floor.
        """
        T = numbers("T_base_camera", T_base_camera, np.float64)
        if T.shape != (4, 4) or not is_rigid(T):
            shaped = T.shape == (4, 4)
            problem = "not a rigid transform" if shaped else f"expected (4, 4), got {T.shape}"
            remedy = "pass a (4, 4) matrix, in metres"
            raise InputError(problem, topic="T_base_camera", remedy=remedy)
        return cls._of(plane_from_transform(T))

    @classmethod
    def _of(cls, plane: GroundPlane) -> Self:
        return cls(*(float(part[0]) for part in plane[:3]))

    @property
    def plane(self) -> GroundPlane:
        """Floor of one frame, ``B = 1``."""
        return flat_plane(self.height_m, self.pitch_rad, self.roll_rad)
