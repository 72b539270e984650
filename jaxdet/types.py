"""Arrays of the pipeline.

Axes: ``B`` frames per batch, ``H W`` colour image, ``Hd Wd`` depth image, ``R C`` depth cells,
``N`` point slots per frame (preset ``paper``), ``M`` obstacle slots per frame. A variable count is
a padded axis plus a mask or a count.

Coordinate frames: the *camera optical frame* has x right, y down, z forward. "The camera" is the
depth camera; in the preset ``paper``, whose depth is aligned to colour, it is the colour camera.
The *ground frame* of a camera has its origin at the ground projection of the optical centre, x
right, y forward. The *world* is the log's map or odom frame. ``T_a_b`` maps points from ``b`` to
``a``.

Units: metres, radians and nanoseconds. Every *decision* is made on integers in *depth units* (the
unit of the depth image, 1 mm by default), so that all implementations agree to the bit. The metric
results are computed from these integers once, in :mod:`jaxdet.results.metric`. Arrays are NumPy
arrays in :mod:`jaxdet.reference` and JAX arrays in :mod:`jaxdet.stages`.
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
"""NumPy or JAX array, used through their common interface (``shape``, ``dtype``, indices, sums);
``np.asarray`` converts it. ``np.ndarray`` in a signature means a NumPy array."""


MAX_CONTOUR = 512
"""Maximum number of points of an obstacle's contour, and of columns of cells: a contour has at most
one point per column."""

MAX_SURFACES = 512
"""Maximum number of surfaces per frame; cells of additional surfaces are not labelled."""

MAX_LABELS = 1024
"""Maximum number of obstacle parts per frame, after bent obstacles are split."""

MAX_OBSTACLES = 128
"""``M`` for obstacles made of surfaces; additional obstacles set the overflow flag."""

RAYS = 1440
"""Number of bearings of the free floor: a full turn in steps of a quarter of a degree. Ray ``i``
has the bearing ``(i - RAYS / 2) / 4`` degrees, clockwise seen from above, 0 is forward."""

MAX_LATERAL = (1 << 18) - 1
"""Maximum lateral distance [depth units]: four times the maximum depth."""

NUM_COEFFICIENTS = 8
"""Maximum number of distortion coefficients."""

MAX_SKEW = 1e-3
"""Maximum deviation of a rotation times its transpose from the identity matrix."""


def is_rotation(values: Sequence[float] | np.ndarray) -> bool:
    """Return whether values, in row-major order, are a rotation matrix."""
    entries = np.array(values, np.float64).ravel()
    if entries.size != 9 or not np.isfinite(entries).all() or np.abs(entries).max() >= 2:
        return False
    R = entries.reshape(3, 3)
    skew = np.abs(matmul(R, R.T) - np.eye(3)).max()
    return bool(skew <= MAX_SKEW and dot(np.cross(R[0], R[1]), R[2]) > 0)


def is_rigid(T: np.ndarray) -> bool:
    """Return whether a matrix ``(4, 4)`` is a rigid transform."""
    last, translation = T[3].tolist(), T[:3, 3]
    flat = last == [0.0, 0.0, 0.0, 1.0] and bool(np.isfinite(translation).all())
    return flat and is_rotation(T[:3, :3])


class Distortion(StrEnum):
    """Lens distortion models, by their names in ROS and Foxglove."""

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
    """Return ``fx fy cx cy`` of a camera matrix ``(3, 3)``.

    Raises:
        CalibrationError: The matrix has another shape, has skew, or is transposed or scaled.
    """
    remedy = "pass a (3, 3) array of numbers"
    try:
        matrix = numbers("K", K, np.float64)
    except InputError:
        problem = f"expected a matrix, got {type(K).__name__}"
        raise CalibrationError(problem, remedy=remedy) from None
    if matrix.shape != (3, 3):
        problem = f"expected a camera matrix of shape (3, 3), got {matrix.shape}"
        raise CalibrationError(problem, remedy=remedy)
    fx, skew, cx, low, fy, cy, *last = matrix.ravel().tolist()
    if skew or low or last != [0.0, 0.0, 1.0]:
        raise CalibrationError(
            f"{matrix.tolist()} is not a camera matrix",
            remedy="pass [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]",
        )
    return fx, fy, cx, cy


class Intrinsics(NamedTuple):
    """Image size, camera matrix and lens; hashable, so that derived tables can be cached."""

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
        """Camera matrix ``(3, 3)`` float64 [pixel]."""
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
        """Build intrinsics from a camera matrix and lens coefficients of OpenCV or ROS.

        Args:
            K: Camera matrix ``(3, 3)`` [pixel].
            width: Image width [pixel].
            height: Image height [pixel].
            distortion: Lens coefficients, at most 8. Additional coefficients, as in OpenCV's models
                with 12 or 14, must be zero. None: images without distortion.
            model: Name of a :class:`Distortion`; by default ``plumb_bob`` for 4 or 5 coefficients
                and ``rational_polynomial`` for 8.

        Raises:
            CalibrationError: ``K`` is not a camera matrix, the model is unknown, or there are too
                many coefficients.

        Example:
            >>> Intrinsics.from_matrix([[600, 0, 320], [0, 610, 240], [0, 0, 1]], 640, 480).fy
            610.0
        """
        array = numbers("distortion", () if distortion is None else distortion, np.float64)
        values = tuple(float(value) for value in array.ravel())
        values, further = values[:NUM_COEFFICIENTS], values[NUM_COEFFICIENTS:]
        if any(further):
            raise CalibrationError(
                f"{len(values + further)} distortion coefficients exceed the maximum of "
                f"{NUM_COEFFICIENTS}",
                remedy="calibrate without thin prism and tilt, or undistort the images",
            )
        if model is None:
            defaults = {0: "none", 4: "plumb_bob", 5: "plumb_bob", 8: "rational_polynomial"}
            model = defaults.get(len(values))
        if not isinstance(model, str | None) or model not in tuple(Distortion):
            named = model if isinstance(model, str | None) else type(model).__name__
            raise CalibrationError(
                f"{len(values)} distortion coefficients with the lens model {named}",
                remedy=f"set model to one of {', '.join(Distortion)}",
            )
        size = whole_number("width", width), whole_number("height", height)
        return cls(*size, *focal_and_center(K), Distortion(model), values)


class Extrinsics(NamedTuple):
    """Rigid transform ``T_target_source``, hashable."""

    rotation: tuple[float, ...]
    """Rotation matrix, nine numbers, row-major."""
    translation: tuple[float, float, float]
    """Translation [m]."""

    @property
    def T(self) -> np.ndarray:
        """Homogeneous matrix ``(4, 4)`` float64."""
        T = np.eye(4)
        T[:3, :3] = np.reshape(self.rotation, (3, 3))
        T[:3, 3] = self.translation
        return T

    @classmethod
    def from_matrix(cls, T: ArrayLike) -> Self:
        """Build extrinsics from a matrix ``(4, 4)`` with its translation in metres.

        Raises:
            CalibrationError: The matrix is not a homogeneous matrix.

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
                f"expected a homogeneous (4, 4) matrix, got shape {matrix.shape}{row}",
                remedy="pass a (4, 4) array whose last row is 0 0 0 1",
            )
        x, y, z = matrix[:3, 3].tolist()
        return cls(tuple(matrix[:3, :3].ravel().tolist()), (x, y, z))


class Calibration(NamedTuple):
    """Cameras of a log and the transform between them; hashable.

    ``Calibration(camera)`` describes depth images without colour, and depth aligned to colour:
    ``color`` is None unless the colour image has other pixels than the depth image.
    """

    depth: Intrinsics
    """Camera of the depth images; the colour camera if depth is aligned to colour."""
    color: Intrinsics | None = None
    """Colour camera; None if it is uncalibrated or has the pixels of the depth images."""
    color_from_depth: Extrinsics | None = None
    """``T_color_depth``; None if ``color`` is None."""
    depth_unit: float = 0.001
    """Metres per depth unit."""

    @property
    def is_aligned(self) -> bool:
        """Whether a colour image, if any, has the pixels of the depth image."""
        return self.color is None

    @property
    def image(self) -> Intrinsics:
        """Camera of the image that boxes refer to: the colour camera, else the depth camera."""
        return self.color or self.depth


class GroundPlane(NamedTuple):
    """Floor of each frame relative to the camera: a plane, and optionally a ramp ahead.

    ``pitch`` is the camera's downward tilt, and ``roll`` its clockwise rotation about the optical
    axis seen from behind (a camera rolled clockwise sees the world rotated counter-clockwise).
    ``valid`` is False if the floor is unknown: then nothing is dropped as floor and a level camera
    is assumed. :func:`jaxdet.flat_plane` builds planes without ramps.
    """

    height: np.ndarray
    """Height of the optical centre above the floor, ``(B,)`` float64 [m]."""
    pitch: np.ndarray
    """Pitch ``(B,)`` float64 [rad], positive looks down."""
    roll: np.ndarray
    """Roll ``(B,)`` float64 [rad], positive clockwise."""
    valid: np.ndarray
    """Whether the floor is known, ``(B,)`` bool."""
    ramp_start: np.ndarray
    """Forward distance on the floor at which a ramp begins, across the whole width, ``(B,)``
    float64 [m]; inf without a ramp."""
    ramp_slope: np.ndarray
    """Rise over run of the ramp relative to the plane, ``(B,)`` float64; negative downhill."""


class Frames(NamedTuple):
    """A batch of depth images on the host, optionally with colour images."""

    depth: np.ndarray
    """Depth images ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement."""
    calibration: Calibration
    number: np.ndarray
    """Number of each depth image in its log, from 0, ``(B,)`` int64."""
    stamp_ns: np.ndarray
    """Timestamp in the header of each depth image, ``(B,)`` int64."""
    valid: np.ndarray
    """Whether each frame is real rather than padding, ``(B,)`` bool."""
    color: np.ndarray | None = None
    """Colour images ``(B, H, W, 3)`` uint8, RGB, zeros for a frame without one; None: not read.
    Only pictures and the preset ``paper`` use colour."""
    color_stamp_ns: np.ndarray | None = None
    """Timestamp in the header of each colour image, ``(B,)`` int64, -1 = none; None: not read."""
    T_world_camera: np.ndarray | None = None
    """Poses of the depth optical frame in the world, ``(B, 4, 4)`` float64, NaN if unknown."""
    plane: GroundPlane | None = None
    """Prior of the floor relative to the depth camera, which the depth of each frame corrects (the
    preset ``paper`` uses it unchanged); None: the configuration's prior."""


class Cells(NamedTuple):
    """Regular grid of depth cells, ``R`` rows and ``C`` columns, in the depth optical frame."""

    x: Array
    """x, to the right, ``(B, R, C)`` int32 [depth units]."""
    y: Array
    """y, downward, ``(B, R, C)`` int32 [depth units]."""
    z: Array
    """z, forward, ``(B, R, C)`` int32 [depth units], 0 = no measurement."""


class AlignedDepth(NamedTuple):
    """Depth at each colour pixel (Eq. 1-4)."""

    depth: Array
    """z in the *depth* camera, ``(B, H, W)`` uint16 [depth units]; equals ``rs.align``."""
    z: Array
    """z in the *colour* camera (Eq. 3), ``(B, H, W)`` uint16 [depth units]; 0 = none."""


class Features(NamedTuple):
    """Corners with depth of the preset ``paper`` (Sections 3.2, 3.3), strongest first.

    Empty slots are zero.
    """

    u: Array
    """Column ``(B, N)`` int32 [pixel]."""
    v: Array
    """Row ``(B, N)`` int32 [pixel]."""
    x: Array
    """x, right of the optical axis, ``(B, N)`` int32 [depth units]."""
    y: Array
    """y, below the optical axis, ``(B, N)`` int32 [depth units]."""
    z: Array
    """z, along the optical axis, ``(B, N)`` int32 [depth units]."""
    valid: Array
    """Whether the slot holds a corner, ``(B, N)`` bool."""
    kept: Array
    """Whether the depth is in range and above the floor, ``(B, N)`` bool."""
    overflow: Array
    """Whether more corners qualified than there are slots, ``(B,)`` bool."""


class Labels(NamedTuple):
    """Obstacle label of each feature (Section 3.4)."""

    labels: Array
    """Labels ``(B, N)`` int32, -1 = none; obstacles are numbered by their smallest z, then x."""
    num_obstacles: Array
    """Number of obstacles, ``(B,)`` int32."""


class Obstacles(NamedTuple):
    """Extent and outline on the floor of each obstacle, in integers (Section 3.5).

    Slots from ``num_obstacles`` on are zero. ``a b c`` are the points A, B, C of Eq. 7 in the
    ground frame: ``[..., 0]`` to the right, ``[..., 1]`` forward, both at most MAX_LATERAL. They
    are the outermost points and the nearest point, or medians of bands behind these, see
    ``FootprintConfig``. The points of an obstacle are its cells; in the preset ``paper`` its
    corners.
    """

    num_points: Array
    """Number of points, ``(B, M)`` int32."""
    uv_min: Array
    """First column and row of the obstacle in the image of :attr:`Calibration.image`, ``(B, M, 2)``
    int32 [pixel]; 0 if the obstacle is outside of it."""
    uv_max: Array
    """Last column and row in that image, ``(B, M, 2)`` int32 [pixel]; -1 if the obstacle is
    outside."""
    xyz_min: Array
    """Minimum x, y, z in the camera optical frame, ``(B, M, 3)`` int32 [depth units]."""
    xyz_max: Array
    """Maximum x, y, z in the camera optical frame, ``(B, M, 3)`` int32 [depth units]."""
    xyz_sum: Array
    """Sums of x, y, z over the points, ``(B, M, 3, 2)`` int32 [depth units], as quotient (rounded
    down) and remainder of division by 2^16; the centroid is sum / num_points."""
    a: Array
    """Leftmost point, the nearest in a tie, ``(B, M, 2)`` int32 [depth units]."""
    b: Array
    """Rightmost point, the nearest in a tie, ``(B, M, 2)`` int32 [depth units]."""
    c: Array
    """Nearest point, the leftmost in a tie, ``(B, M, 2)`` int32 [depth units]."""
    has_vertex: Array
    """Whether C is a vertex towards the camera (Eq. 7), ``(B, M)`` bool."""
    direction: Array
    """Direction of the fitted rectangle, right and forward, about 512 long, ``(B, M, 2)`` int32;
    zero for clusters of points."""
    span: Array
    """Extent of the fitted rectangle, ``(B, M, 4)`` int32: minimum and maximum of the dot product
    of ``direction`` and a point, then of their cross product [depth units x about 512]."""
    nearest: Array | None = None
    """Squared distance on the floor from the camera to the nearest point, ``(B, M, 2)`` int32
    [depth units squared], as quotient (rounded down) and remainder of division by 2^18; None for
    obstacles made of surfaces, as their contours contain the nearest point."""


class FreeEnd(IntEnum):
    """Reason why the free floor ends in a direction."""

    UNKNOWN = 0
    """There is no measurement beyond the end, or no visible floor at all."""
    OBSTACLE = 1
    """An obstacle, or points above the step height that are too few for one."""
    DROP = 2
    """Points beyond are clearly below the floor: a step down or a hole."""
    RANGE = 3
    """The end of the depth range."""


class Refusal(IntEnum):
    """Reason why a frame's own depth does not determine its floor."""

    NONE = 0
    """Not refused."""
    TOO_LITTLE = 1
    """Too few inliers of any plane."""
    MOSTLY_OBSTACLE = 2
    """The best plane would make most of the image an obstacle."""
    FAR = 3
    """The best plane is too far from the prior and not a ramp ahead; without a prior, its tilt is
    too large for a floor."""
    TABLE = 4
    """Too many cells are below the best plane."""


class Scene(NamedTuple):
    """Floor, contours and free floor of each frame."""

    floor: Array
    """Floor estimated from each frame's own depth, ``(B, 8)`` int32;
    :func:`jaxdet.floor.units.floor_fit` computes planes from it and ``prior``."""
    prior: GroundPlane
    """Prior of each frame's floor, on the host."""
    contour: Array
    """Points on the visible edge of each obstacle, from left to right: coordinates (right, forward)
    in the ground frame, ``(B, M, C, 2)`` int32 [depth units]; C columns of cells, or 1."""
    contour_points: Array
    """Number of contour points, ``(B, M)`` int32."""
    bottom_top: Array
    """Height of the lowest and of the highest cell above the floor, ``(B, M, 2)`` int32 [depth
    units]."""
    free: Array
    """Range at which the free floor of each ray starts and ends, measured from the ground
    projection of the camera, ``(B, RAYS, 2)`` int32 [depth units]. Both are equal if only an
    obstacle is visible, and zero if nothing is."""
    free_end: Array
    """End of the free floor of each ray, ``(B, RAYS)`` int32, see :class:`FreeEnd`."""
    first_notch: Array
    """Label of the first obstacle that was found only as a notch in the free floor, ``(B,)`` int32.
    Obstacles found only as notches have the last labels, from left to right."""


class CellLabels(NamedTuple):
    """Depth cells with their obstacle labels."""

    label: Array
    """Label ``(B, R, C)`` int32, -1 = none."""
    keep: Array
    """Whether the cell is in range and above the step height, ``(B, R, C)`` bool. Such a cell has
    no label if its surface is too small for an obstacle; lower parts of obstacles, and obstacles
    found by the free floor, have labels on other cells too."""
    cells: Cells


class Points(NamedTuple):
    """Corners that the preset ``paper`` clusters, and their obstacle labels."""

    features: Features
    labels: Labels


class Detections(NamedTuple):
    """Results of a batch."""

    num_obstacles: Array
    """Number of obstacles, ``(B,)`` int32."""
    overflow: Array
    """Whether obstacles may be missing, ``(B,)`` bool, because there are more than ``MAX_SURFACES``
    surfaces or ``MAX_OBSTACLES`` obstacles or, in the preset ``paper``, more corners than slots."""
    has_depth: Array
    """Whether any depth of the frame is in range, ``(B,)`` bool."""
    obstacles: Obstacles
    scene: Scene | None = None
    """Outlines, floor and free floor; None in the preset ``paper``."""
    cells: CellLabels | None = None
    """Depth cells, if requested; None in the preset ``paper``."""
    points: Points | None = None
    """Corners of the preset ``paper``; None elsewhere."""
