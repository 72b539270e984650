"""The arrays that flow through the pipeline.

Axes, used everywhere: ``B`` frames in a batch, ``H W`` colour image, ``Hd Wd`` depth image,
``R C`` depth cells, ``N`` point slots per frame (preset ``paper``), ``M`` obstacle slots per frame.
A variable count is a padded axis plus a mask or a count.

Frames of reference: the *camera optical frame* has x right, y down, z forward. "The camera" is the
depth camera; in the preset ``paper``, whose depth is aligned to colour, it is the colour camera.
The *ground frame* of a camera is its optical centre projected onto the floor, x right, y forward.
The *world* is the log's map or odom frame. ``T_a_b`` takes points of ``b`` to ``a``.

Units: metres, radians and nanoseconds, but every *decision* is made on integers in *depth
units* (the unit of the depth image, 1 mm by default), so that all implementations agree to
the bit. The metric results are computed from these integers once, in :mod:`jaxdet.results.metric`.
Arrays are NumPy arrays in :mod:`jaxdet.reference` and JAX arrays in :mod:`jaxdet.stages`.
"""

from collections.abc import Sequence
from enum import IntEnum, StrEnum
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from jaxdet.arguments import numbers, whole_number
from jaxdet.elementary import dot, matmul
from jaxdet.errors import CalibrationError, InputError

Array = Any
"""A NumPy or a JAX array: what both have (``shape``, ``dtype``, indices, sums) can be used, and
``np.asarray`` makes the first of either. Where a signature says ``np.ndarray`` it is one."""


MAX_CONTOUR = 512
"""Most points of an obstacle's contour: columns of cells."""

MAX_SURFACES = 512
"""Most surfaces of a frame; the cells of others belong to none."""

MAX_LABELS = 1024
"""Most parts of obstacles of a frame, once those that bend are split."""

MAX_OBSTACLES = 128
"""``M`` where obstacles are made of surfaces; more set the overflow flag."""

RAYS = 1440
"""Bearings of the free floor: a full turn, a quarter of a degree apart. The ray ``i`` has the
bearing ``(i - RAYS / 2) / 4`` degrees, clockwise from above, 0 ahead."""

MAX_LATERAL = (1 << 18) - 1
"""Largest sideways distance [depth units]: four times the largest depth."""

NUM_COEFFICIENTS = 8
"""Most distortion coefficients of a lens."""

MAX_SKEW = 1e-3
"""How far the product of a rotation and its transpose may be from the unit matrix."""


def is_rotation(values: Sequence[float] | np.ndarray) -> bool:
    """Whether numbers, row by row, are those of a rotation matrix."""
    found = np.array(values, np.float64).ravel()
    if found.size != 9 or not np.isfinite(found).all() or np.abs(found).max() >= 2:
        return False
    R = found.reshape(3, 3)
    skew = np.abs(matmul(R, R.T) - np.eye(3)).max()
    return bool(skew <= MAX_SKEW and dot(np.cross(R[0], R[1]), R[2]) > 0)


def is_rigid(T: np.ndarray) -> bool:
    """Whether a matrix ``(4, 4)`` is that of a rigid motion."""
    last, translation = T[3].tolist(), T[:3, 3]
    flat = last == [0.0, 0.0, 0.0, 1.0] and bool(np.isfinite(translation).all())
    return flat and is_rotation(T[:3, :3])


class Distortion(StrEnum):
    """Lens distortion models; the values are the names ROS and Foxglove use."""

    NONE = "none"
    PLUMB_BOB = "plumb_bob"
    """Brown-Conrady, OpenCV's ``k1 k2 p1 p2 k3``."""
    RATIONAL = "rational_polynomial"
    """OpenCV's ``k1 k2 p1 p2 k3 k4 k5 k6``."""
    EQUIDISTANT = "equidistant"
    """Kannala-Brandt, OpenCV's fisheye ``k1 k2 k3 k4``."""
    INVERSE_BROWN_CONRADY = "inverse_brown_conrady"
    """RealSense's depth-side model, ``k1 k2 p1 p2 k3``."""


def focal_and_center(K: ArrayLike) -> tuple[float, float, float, float]:
    """``fx fy cx cy`` of a camera matrix ``(3, 3)``.

    Raises:
        CalibrationError: It is none: of another shape, with skew, transposed or scaled.
    """
    remedy = "give a (3, 3) array of numbers"
    try:
        matrix = numbers("K", K, np.float64)
    except InputError:
        raise CalibrationError(f"{type(K).__name__} is no matrix", remedy=remedy) from None
    if matrix.shape != (3, 3):
        raise CalibrationError(f"a camera matrix of shape {matrix.shape}", remedy=remedy)
    fx, skew, cx, low, fy, cy, *last = matrix.ravel().tolist()
    if skew or low or last != [0.0, 0.0, 1.0]:
        raise CalibrationError(
            f"{matrix.tolist()} is no camera matrix",
            remedy="give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]",
        )
    return fx, fy, cx, cy


class Intrinsics(NamedTuple):
    """A camera's image size, matrix and lens; hashable, so derived tables can be cached."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion = Distortion.NONE
    coefficients: tuple[float, ...] = ()

    @property
    def K(self) -> np.ndarray:
        """The camera matrix ``(3, 3)`` float64, pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @classmethod
    def from_matrix(
        cls,
        K: ArrayLike,
        width: int,
        height: int,
        distortion: Sequence[float] | np.ndarray | None = None,
        model: str | None = None,
    ) -> Self:
        """From a camera matrix and lens coefficients as OpenCV and ROS have them.

        Args:
            K: ``(3, 3)``, pixels.
            width: Of the images [pixel].
            height: Of the images [pixel].
            distortion: The lens coefficients, at most 8 (of OpenCV's 12 or 14 the others must be
                zero); None: images without distortion.
            model: A :class:`Distortion`; by default ``plumb_bob`` for 4 or 5 coefficients and
                ``rational_polynomial`` for 8.

        Raises:
            CalibrationError: ``K`` is no camera matrix, the model is unknown, or there are too
                many coefficients.

        Example:
            >>> Intrinsics.from_matrix([[600, 0, 320], [0, 610, 240], [0, 0, 1]], 640, 480).fy
            610.0
        """
        given = numbers("distortion", () if distortion is None else distortion, np.float64)
        values = tuple(float(value) for value in given.ravel())
        values, further = values[:NUM_COEFFICIENTS], values[NUM_COEFFICIENTS:]
        if any(further):
            raise CalibrationError(
                f"{len(values + further)} distortion coefficients, but at most {NUM_COEFFICIENTS} "
                "are taken",
                remedy="calibrate without thin prism and tilt, or undistort the images",
            )
        if model is None:
            defaults = {0: "none", 4: "plumb_bob", 5: "plumb_bob", 8: "rational_polynomial"}
            model = defaults.get(len(values))
        if not isinstance(model, str | None) or model not in tuple(Distortion):
            named = model if isinstance(model, str | None) else type(model).__name__
            raise CalibrationError(
                f"{len(values)} distortion coefficients of the lens model {named}",
                remedy=f"model can be {', '.join(Distortion)}",
            )
        size = whole_number("width", width), whole_number("height", height)
        return cls(*size, *focal_and_center(K), Distortion(model), values)


class Extrinsics(NamedTuple):
    """A rigid motion ``T_target_source``, hashable."""

    rotation: tuple[float, ...]
    """Nine numbers, row-major."""
    translation: tuple[float, float, float]
    """Metres."""

    @property
    def T(self) -> np.ndarray:
        """The matrix ``(4, 4)`` float64."""
        T = np.eye(4)
        T[:3, :3] = np.reshape(self.rotation, (3, 3))
        T[:3, 3] = self.translation
        return T

    @classmethod
    def from_matrix(cls, T: ArrayLike) -> Self:
        """From a matrix ``(4, 4)``, its translation in metres.

        Raises:
            CalibrationError: It is no matrix of a rigid motion.

        Example:
            >>> Extrinsics.from_matrix(np.eye(4)).translation
            (0.0, 0.0, 0.0)
        """
        try:
            matrix = numbers("T", T, np.float64)
        except InputError:
            matrix = np.zeros(0)
        if matrix.shape != (4, 4) or matrix[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
            row = f" and last row {matrix[3].tolist()}" if matrix.shape == (4, 4) else ""
            raise CalibrationError(
                f"a transform of shape {matrix.shape}{row}",
                remedy="give a (4, 4) array whose last row is 0 0 0 1",
            )
        x, y, z = matrix[:3, 3].tolist()
        return cls(tuple(matrix[:3, :3].ravel().tolist()), (x, y, z))


class Calibration(NamedTuple):
    """The cameras of a log and how depth pixels relate to colour pixels; hashable.

    ``Calibration(camera)`` describes depth images without colour, and depth that is aligned to
    colour alike: ``color`` is None where there is no other camera than that of the depth images.
    """

    depth: Intrinsics
    """The camera of the depth images; of aligned depth this is the colour camera."""
    color: Intrinsics | None = None
    """The colour camera, where it is calibrated and not the camera of the depth images."""
    color_from_depth: Extrinsics | None = None
    """``T_color_depth``; None where ``color`` is None."""
    depth_unit: float = 0.001
    """Metres in one depth unit."""

    @property
    def is_aligned(self) -> bool:
        """Whether a colour image, if there is one, has the pixels of the depth image."""
        return self.color is None

    @property
    def image(self) -> Intrinsics:
        """The camera of the image in which boxes are: the colour camera, else the depth camera."""
        return self.color or self.depth


class GroundPlane(NamedTuple):
    """The floor seen from the camera in each frame: a plane, and perhaps a ramp ahead.

    ``pitch`` is the camera's downward tilt and ``roll`` its clockwise turn about the optical
    axis as seen from behind the camera (a camera rolled clockwise sees the world turned
    counter-clockwise). ``valid`` is False where the floor is unknown: then nothing is dropped
    as floor and the camera is taken as level. :func:`jaxdet.flat_plane` makes one without ramps.
    """

    height: np.ndarray
    """``(B,)`` float64, optical centre above the floor [m]."""
    pitch: np.ndarray
    """``(B,)`` float64 [rad], positive looks down."""
    roll: np.ndarray
    """``(B,)`` float64 [rad], positive clockwise."""
    valid: np.ndarray
    """``(B,)`` bool."""
    ramp_start: np.ndarray
    """``(B,)`` float64, distance on the floor, forward of the camera, at which a ramp begins
    across the whole floor [m]; inf where there is none."""
    ramp_slope: np.ndarray
    """``(B,)`` float64, the ramp's rise over its run, against the plane; downhill negative."""


class Frames(NamedTuple):
    """A batch of depth images on the host, with their colour images where these are used."""

    depth: np.ndarray
    """``(B, Hd, Wd)`` uint16, depth units, 0 = no measurement."""
    calibration: Calibration
    number: np.ndarray
    """``(B,)`` int64, 0-based number of the depth image in its log."""
    stamp_ns: np.ndarray
    """``(B,)`` int64, header stamp of the depth image."""
    valid: np.ndarray
    """``(B,)`` bool; False marks padding, whose results are dropped."""
    color: np.ndarray | None = None
    """``(B, H, W, 3)`` uint8, RGB, zeros where a frame has none; None: not read. The method reads
    depth alone; pictures show colour, and the preset ``paper`` needs it."""
    color_stamp_ns: np.ndarray | None = None
    """``(B,)`` int64, header stamp of each frame's colour image, -1 = none; None: not read."""
    T_world_camera: np.ndarray | None = None
    """``(B, 4, 4)`` float64, depth optical frame to world, NaN where unknown; None without."""
    plane: GroundPlane | None = None
    """Prior of the floor in each frame, seen from the depth camera, which the frame's own depth
    corrects (the preset ``paper`` takes it as it is); None leaves it to the configuration."""


class Cells(NamedTuple):
    """A regular grid of depth cells, ``R`` rows and ``C`` columns, in the depth optical frame."""

    x: Array
    """``(B, R, C)`` int32, to the right [depth units]."""
    y: Array
    """``(B, R, C)`` int32, down in the camera [depth units]."""
    z: Array
    """``(B, R, C)`` int32, forward [depth units], 0 = no measurement."""


class AlignedDepth(NamedTuple):
    """Depth at each colour pixel (Eq. 1-4)."""

    depth: Array
    """``(B, H, W)`` uint16, z in the *depth* camera [depth units]; equals ``rs.align``."""
    z: Array
    """``(B, H, W)`` uint16, z in the *colour* camera (Eq. 3) [depth units]; 0 = none."""


class Keep(NamedTuple):
    """Where obstacles can be (Section 3.3)."""

    mask: Array
    """``(B, H, W)`` bool, the depth is in range and above the floor."""
    z: Array
    """``(B, H, W)`` uint16, the depth that a feature here gets [depth units]; 0 = none."""
    has_depth: Array
    """``(B,)`` bool, some pixel of the frame has a depth in range."""


class Features(NamedTuple):
    """Corners with depth of the preset ``paper`` (Sections 3.2, 3.3), strongest first.

    Empty slots are zero.
    """

    u: Array
    """``(B, N)`` int32, column [pixel]."""
    v: Array
    """``(B, N)`` int32, row [pixel]."""
    x: Array
    """``(B, N)`` int32, right of the optical axis [depth units]."""
    y: Array
    """``(B, N)`` int32, below the optical axis [depth units]."""
    z: Array
    """``(B, N)`` int32, along the optical axis [depth units]."""
    valid: Array
    """``(B, N)`` bool, the slot holds a corner."""
    kept: Array
    """``(B, N)`` bool, the depth is in range and above the floor."""
    overflow: Array
    """``(B,)`` bool, more corners qualified than there are slots."""


class Labels(NamedTuple):
    """Obstacle number of each feature (Section 3.4)."""

    labels: Array
    """``(B, N)`` int32, -1 = none; numbered by nearest z, then smallest x."""
    num_obstacles: Array
    """``(B,)`` int32."""


class Obstacles(NamedTuple):
    """Each obstacle's extent and outline on the floor, in integers (Section 3.5).

    Slots from ``num_obstacles`` on are zero. ``a b c`` are the points A, B, C of Eq. 7 in the
    ground frame: ``[..., 0]`` to the right, ``[..., 1]`` forward, both at most MAX_LATERAL. They
    are the outermost and the nearest points of the paper, or the medians of bands behind those, see
    ``FootprintConfig``. Points are the cells of an obstacle; in the preset ``paper`` its corners.
    """

    num_points: Array
    """``(B, M)`` int32."""
    uv_min: Array
    """``(B, M, 2)`` int32, first column and row in the image of :attr:`Calibration.image` [pixel];
    of an obstacle outside of the colour image 0."""
    uv_max: Array
    """``(B, M, 2)`` int32, last column and row [pixel]; of an obstacle outside of the colour image
    -1."""
    xyz_min: Array
    """``(B, M, 3)`` int32, camera optical frame [depth units]."""
    xyz_max: Array
    """``(B, M, 3)`` int32, camera optical frame [depth units]."""
    xyz_sum: Array
    """``(B, M, 3, 2)`` int32, camera optical frame [depth units]: the sum of each axis over 2^16,
    rounded down, and what is left of it, below 2^16; the centroid is sum / points."""
    a: Array
    """``(B, M, 2)`` int32, the point to the left (of those, the nearest) [depth units]."""
    b: Array
    """``(B, M, 2)`` int32, the point to the right (of those, the nearest) [depth units]."""
    c: Array
    """``(B, M, 2)`` int32, the point in front (of those, the leftmost) [depth units]."""
    has_vertex: Array
    """``(B, M)`` bool, Eq. 7: C stands out towards the camera."""
    direction: Array
    """``(B, M, 2)`` int32, along the fitted rectangle, right and forward, about 512 long; zero for
    clusters of points."""
    span: Array
    """``(B, M, 4)`` int32, the rectangle's extent along ``direction`` (dot product) and across
    (cross product): least and largest along, least and largest across."""


class FreeEnd(IntEnum):
    """What ends the free floor in a direction."""

    UNKNOWN = 0
    """Nothing is measured beyond, or no floor is seen at all."""
    OBSTACLE = 1
    """An obstacle, or what is measured above the step and too small for one."""
    DROP = 2
    """What is seen beyond lies clearly below the floor: a step down, a hole."""
    RANGE = 3
    """The end of the depth range."""


class Refusal(IntEnum):
    """Why a frame's own depth does not decide its floor."""

    NONE = 0
    """It does."""
    TOO_LITTLE = 1
    """Too few cells lie on any one plane."""
    MOSTLY_OBSTACLE = 2
    """The best plane makes most of the picture an obstacle."""
    FAR = 3
    """The best plane is too far from the prior and no ramp ahead of it, or without a prior more
    tilted than a floor is seen."""
    TABLE = 4
    """Too much is seen below the best plane."""


class Scene(NamedTuple):
    """Floor, contours and free floor of each frame."""

    floor: Array
    """``(B, 8)`` int32, the floor in each frame's own depth; with the next one it gives the planes
    (:func:`jaxdet.floor.units.floor_fit`)."""
    prior: GroundPlane
    """The prior of each frame's floor, on the host."""
    contour: Array
    """``(B, M, C, 2)`` int32, C columns of cells or 1, the visible edge of each obstacle, right and
    forward in the ground frame, from left to right [depth units]."""
    contour_points: Array
    """``(B, M)`` int32, how many of them are used."""
    bottom_top: Array
    """``(B, M, 2)`` int32, lowest and highest cell above the floor [depth units]."""
    free: Array
    """``(B, RAYS, 2)`` int32, by bearing: the range from the camera's foot at which the free floor
    begins and at which it ends [depth units]; both the same where only an obstacle is seen, zero
    where nothing is."""
    free_end: Array
    """``(B, RAYS)`` int32, what ends it, see :class:`FreeEnd`."""


class CellLabels(NamedTuple):
    """The depth cells, each with its obstacle."""

    label: Array
    """``(B, R, C)`` int32, -1 = none."""
    keep: Array
    """``(B, R, C)`` bool, in range and above the floor: a cell of an obstacle or of what is too
    small for one."""
    cells: Cells


class Points(NamedTuple):
    """The corners that the preset ``paper`` clusters, and the obstacle of each."""

    features: Features
    labels: Labels


class Detections(NamedTuple):
    """All that is found in a batch."""

    num_obstacles: Array
    """``(B,)`` int32."""
    overflow: Array
    """``(B,)`` bool, obstacles may be lost: there are more surfaces than ``MAX_SURFACES`` or more
    obstacles than ``MAX_OBSTACLES``; in the preset ``paper``, more corners than slots."""
    has_depth: Array
    """``(B,)`` bool, some depth of the frame is in range."""
    obstacles: Obstacles
    scene: Scene | None = None
    """Outlines, floor and free floor; None in the preset ``paper``."""
    cells: CellLabels | None = None
    """The depth cells, where requested; None in the preset ``paper``."""
    points: Points | None = None
    """The corners of the preset ``paper``; None elsewhere."""
