"""What was found, as objects: a batch, its frames, their obstacles."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import numpy as np

from jaxdet.camera import cell_side
from jaxdet.checks import check_size
from jaxdet.config import Config
from jaxdet.detector.arguments import ColorOrder, color_images, named, one_frame
from jaxdet.errors import ConfigError, FrameStatus
from jaxdet.floor.mount import Mount
from jaxdet.results.masks import label_image, obstacle_points
from jaxdet.results.metric import rectangles
from jaxdet.results.rows import Rows
from jaxdet.types import Detections, Frames

if TYPE_CHECKING:
    from jaxdet.io import Batch
    from jaxdet.results.lists import Lists


class FreeFloorLine(NamedTuple):
    """Free floor, an entry for each ray that shows anything, left to right."""

    bearing_rad: np.ndarray
    """``(C,)`` float32, of the ray, clockwise from above, 0 ahead."""
    from_m: np.ndarray
    """``(C,)`` float32, distance from the camera's foot on the floor to where it begins [m]."""
    to_m: np.ndarray
    """``(C,)`` float32, and to where it ends [m]."""
    end: np.ndarray
    """``(C,)`` int8, what ends it, see :class:`jaxdet.types.FreeEnd`."""


@dataclass(frozen=True, eq=False, repr=False)
class Obstacle:
    """One obstacle. The values are those of its row in ``obstacles.parquet``.

    Attributes:
        label: Number in its frame, by the least depth that the depth camera measured of it: 0 is
            not always the nearest. The value of its pixels in :attr:`FrameResult.labels`.
        distance_m: From the camera's foot on the floor to its nearest point [m].
        box: First column and row, last column and row of it [pixel], in the colour image of a
            calibrated colour camera, else in the depth image; None where it is outside of the
            colour image.
        xyz_min: ``(3,)`` float32, least x, y and z in the camera's optical frame [m].
        xyz_max: ``(3,)`` float32, largest x, y and z [m].
        centroid: ``(3,)`` float32, x, y and z [m].
        bottom_m: Its lowest cell seen above the floor [m], what stands on it has about the step's
            height; None where the floor is not known.
        top_m: Its highest cell above the floor [m]; None likewise.
        contour: ``(P, 2)`` float32, its visible edge on the floor from left to right, right and
            forward of the camera [m]; None for clusters of points.
        corners: ``(4, 2)`` float32, its outline on the floor, right and forward [m].
        corners_world: ``(4, 2)`` float64, the same in the world, X and Y [m]; None without a pose
            or a floor.
        num_points: Its depth cells; in the preset ``paper`` its corners.
    """

    label: int
    distance_m: float
    box: tuple[int, int, int, int] | None
    xyz_min: np.ndarray
    xyz_max: np.ndarray
    centroid: np.ndarray
    bottom_m: float | None
    top_m: float | None
    contour: np.ndarray | None
    corners: np.ndarray
    corners_world: np.ndarray | None
    num_points: int
    frame: "FrameResult"

    def __repr__(self) -> str:
        high = "" if self.top_m is None else f", {self.bottom_m:.2f} to {self.top_m:.2f} m high"
        return f"<Obstacle {self.label}: {self.distance_m:.2f} m away{high}, box {self.box}>"

    @property
    def points(self) -> np.ndarray:
        """``(num_points, 3)`` float32, its points in the camera's optical frame, x, y and z [m]."""
        return self.frame.points[self.frame.point_labels == self.label]

    def mask(self) -> np.ndarray:
        """``(H, W)`` bool, its pixels, see :attr:`FrameResult.labels`."""
        return self.frame.labels == self.label


class FrameResult(Sequence[Obstacle]):
    """What was found in a frame: a sequence of its obstacles, in the order of their labels.

    It keeps the arrays of its batch, images included, some 1.3 MB per frame without colour.
    """

    def __init__(self, batch: "BatchResult", row: int) -> None:
        self._batch, self._row = batch, row

    @overload
    def __getitem__(self, index: int) -> Obstacle: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Obstacle, ...]: ...
    def __getitem__(self, index: Any) -> Any:
        """An obstacle by its label, or some."""
        return self.obstacles[index]

    def __len__(self) -> int:
        return self._batch.counts[self._row]

    def __repr__(self) -> str:
        near = "" if self.nearest_m is None else f", the nearest at {self.nearest_m:.2f} m"
        return f"<FrameResult {self.number}: {self.status}, {len(self)} obstacles{near}>"

    @property
    def number(self) -> int:
        """Number in the log or in the batch, from 0."""
        return int(self._batch.frames.number[self._row])

    @property
    def stamp_ns(self) -> int:
        """Time of the depth image [ns]."""
        return int(self._batch.frames.stamp_ns[self._row])

    @property
    def status(self) -> FrameStatus:
        """``ok``, or why nothing can be said, for instance ``no_depth``."""
        return FrameStatus(self._column("status"))

    @property
    def error(self) -> str:
        """Why a frame of a log can't be used; empty where it can."""
        return self._batch.errors[self._row]

    @cached_property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """The obstacles, in the order of their labels."""
        return tuple(self._batch.obstacles_of(self, self._row))

    @property
    def nearest_m(self) -> float | None:
        """Distance of the nearest obstacle [m]; None where there is none."""
        return min((obstacle.distance_m for obstacle in self.obstacles), default=None)

    @property
    def floor(self) -> Mount | None:
        """The camera above the floor that was used; None where no floor is known."""
        plane = self._batch.rows.plane
        if not plane.valid[self._row]:
            return None
        return Mount(*(float(part[self._row]) for part in plane[:3]))

    @property
    def floor_source(self) -> str:
        """Where that comes from: ``frame`` (its own depth), ``mount`` (what was given) or ``none``.

        Of a log's frames what the table has: ``window``, ``log``, ``tf`` or ``flags`` as well.
        """
        return str(self._column("floor_source"))

    @property
    def floor_refused(self) -> str | None:
        """Why the frame's own depth did not decide: a :class:`jaxdet.types.Refusal`, or None."""
        reason = self._column("floor_refused")
        return None if reason is np.ma.masked else str(reason)

    @property
    def overflow(self) -> bool:
        """Whether there was more than there is room for, see the table."""
        return bool(self._column("overflow"))

    @property
    def free_floor(self) -> FreeFloorLine | None:
        """Free floor; None for clusters of points and where the frame can't be used."""
        names = ("free_bearing_rad", "free_from_m", "free_to_m", "free_end")
        lists: list[Lists] = [self._batch.rows.frames[name] for name in names]
        if lists[0].null[self._row]:
            return None
        start, stop = lists[0].offsets[self._row : self._row + 2]
        return FreeFloorLine(*(part.values[start:stop] for part in lists))

    @property
    def drop_m(self) -> float | None:
        """Distance of the nearest drop [m]; None where there is none."""
        value = float(self._column("drop_m"))
        return None if np.isnan(value) else value

    @cached_property
    def labels(self) -> np.ndarray:
        """``(H, W)`` int32, the obstacle of each pixel of the image of boxes, -1 = none.

        As fine as depth cells are (3 to 4 pixels of a depth image); where several cells cover a
        pixel, that of the nearest.

        Raises:
            ConfigError: Obstacles are clusters of points.
        """
        found = self._batch.found.cells
        if found is None:
            raise ConfigError(
                "clusters of points have no masks", remedy="use another preset than paper"
            )
        calibration, config = self._batch.frames.calibration, self._batch.config
        if not len(self):
            camera = calibration.image
            return np.full((camera.height, camera.width), -1, np.int32)
        side = cell_side(calibration.depth, config.surface.cell_rad)
        return label_image(found, self._row, calibration, side)

    @property
    def points(self) -> np.ndarray:
        """``(P, 3)`` float32, the points of all obstacles in the camera's optical frame [m]."""
        return self._labelled[0]

    @property
    def point_labels(self) -> np.ndarray:
        """``(P,)`` int32, the obstacle of each."""
        return self._labelled[1]

    @cached_property
    def _labelled(self) -> tuple[np.ndarray, np.ndarray]:
        found, row = self._batch.found, self._row
        if not len(self):
            return np.zeros((0, 3), np.float32), np.zeros(0, np.int32)
        return obstacle_points(found, row, self._batch.frames.calibration.depth_unit)

    def draw(self, color: Any = None) -> np.ndarray:
        """Draw a picture as ``jaxdet run`` does.

        Args:
            color: Colour image of the frame; None: the one that the detector was given, and
                without one the depth image in colours.

        Returns:
            ``(h, w, 3)`` uint8, RGB, some 1280 pixels wide.
        """
        from jaxdet.render import draw_frame

        batch, row = self._batch, self._row
        frames, unit = batch.frames, batch.frames.calibration.depth_unit
        if color is not None:
            image = color_images(one_frame("color", color), batch.color_order)
            with named("color"):
                check_size("colour", image.shape, frames.calibration.image)
            images = np.broadcast_to(image, (len(batch), *image.shape[1:]))
            frames = frames._replace(color=images, color_stamp_ns=frames.stamp_ns)
        corners = rectangles(batch.found.obstacles, unit, batch.config.footprint)
        title = f"frame {self.number}"
        return draw_frame(frames, batch.found, corners, row, batch.config, title)

    def _column(self, name: str) -> Any:
        return self._batch.rows.frames[name][self._row]


class BatchResult(Sequence[FrameResult]):
    """What was found in a batch: a sequence of frames, and the arrays behind them.

    Attributes:
        frames: The frames; ``frames.plane`` is the floor of each.
        found: All that was found, NumPy arrays with a padded axis, see
            :class:`jaxdet.Detections`.
        rows: The columns of the two tables.
    """

    def __init__(
        self, batch: "Batch", found: Detections, rows: Rows, config: Config, order: ColorOrder
    ) -> None:
        self.frames: Frames = batch.frames._replace(plane=rows.plane)
        self.found, self.rows, self.config = found, rows, config
        self.color_order: ColorOrder = order
        self.errors = batch.errors
        self.counts: list[int] = rows.frames["num_obstacles"].tolist()
        self._first = np.cumsum([0, *self.counts]).tolist()

    def __len__(self) -> int:
        return len(self.counts)

    def __repr__(self) -> str:
        return f"<BatchResult: {len(self)} frames, {sum(self.counts)} obstacles>"

    @overload
    def __getitem__(self, index: int) -> FrameResult: ...
    @overload
    def __getitem__(self, index: slice) -> list[FrameResult]: ...
    def __getitem__(self, index: Any) -> Any:
        """A frame's result by its place in the batch, or some."""
        rows = range(len(self))[index]
        if isinstance(rows, range):
            return [FrameResult(self, row) for row in rows]
        return FrameResult(self, rows)

    def obstacles_of(self, frame: FrameResult, row: int) -> Iterator[Obstacle]:
        """The obstacles of a frame, from their rows."""
        columns = self.rows.obstacles
        contours: Lists = columns["contour"]
        for at in range(self._first[row], self._first[row + 1]):
            box = [columns[name][at] for name in ("u_min", "v_min", "u_max", "v_max")]
            outside = any(side is np.ma.masked for side in box)
            low, high, middle = (
                np.array([columns[axis + end][at] for axis in "xyz"], np.float32)
                for end in ("_min", "_max", "")
            )
            start, stop = contours.offsets[at : at + 2]
            contour = contours.values[start:stop].reshape(-1, 2)
            world = columns["corners_world"][at].reshape(4, 2)
            yield Obstacle(
                label=int(columns["obstacle"][at]),
                distance_m=float(columns["distance_m"][at]),
                box=None if outside else (int(box[0]), int(box[1]), int(box[2]), int(box[3])),
                xyz_min=low,
                xyz_max=high,
                centroid=middle,
                bottom_m=_known(columns["bottom_m"][at]),
                top_m=_known(columns["top_m"][at]),
                contour=None if contours.null[at] else contour,
                corners=columns["corners_ground"][at].reshape(4, 2),
                corners_world=None if np.isnan(world).any() else world,
                num_points=int(columns["num_points"][at]),
                frame=frame,
            )


def _known(value: np.floating) -> float | None:
    return None if np.isnan(value) else float(value)
