"""Results as objects: batches, frames and obstacles."""

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
from jaxdet.notebook import table
from jaxdet.results.masks import label_image, obstacle_points
from jaxdet.results.metric import distance_text, rectangles
from jaxdet.results.rows import Rows
from jaxdet.types import Detections, Frames

if TYPE_CHECKING:
    import pandas as pd

    from jaxdet.io import Batch
    from jaxdet.results.rows import Lists


class FreeFloorLine(NamedTuple):
    """Free floor along rays, from left to right; rays without a measurement are omitted."""

    bearing_rad: np.ndarray
    """Bearing of the ray, ``(C,)`` float32 [rad], clockwise seen from above, 0 is forward."""
    from_m: np.ndarray
    """Distance from the camera's ground projection to the start of the free floor, ``(C,)`` float32
    [m]."""
    to_m: np.ndarray
    """Distance to the end of the free floor, ``(C,)`` float32 [m]."""
    end: np.ndarray
    """Reason why the free floor ends, ``(C,)`` int8, see :class:`jaxdet.types.FreeEnd`."""


@dataclass(frozen=True, eq=False, repr=False)
class Obstacle:
    """An obstacle, with the values of its row in ``obstacles.parquet``.

    Attributes:
        label: Number in the frame, in order of the smallest depth, so 0 is not always the nearest
            obstacle; obstacles with the evidence ``free_floor`` come last. Its pixels have this
            value in :attr:`FrameResult.labels`.
        distance_m: Distance from the camera's ground projection to the nearest point [m]; None if
            the floor is unknown. The depth ``xyz_min[2]`` is always known.
        box: First column and row, last column and row [pixel], in the colour image of a calibrated
            colour camera, else in the depth image; None if the obstacle is outside of the image.
        xyz_min: Minimum x, y and z in the camera's optical frame, ``(3,)`` float32 [m].
        xyz_max: Maximum x, y and z, ``(3,)`` float32 [m].
        centroid: Centroid x, y and z, ``(3,)`` float32 [m].
        bottom_m: Height of the lowest visible cell above the floor [m], about the step height for
            objects that stand on the floor; None if the floor is unknown.
        top_m: Height of the highest cell above the floor [m]; None if the floor is unknown.
        contour: Visible edge on the floor from left to right, ``(P, 2)`` float32, right and forward
            of the camera [m]; None in the preset ``paper`` and if the floor is unknown.
        corners: Outline on the floor, ``(4, 2)`` float32, right and forward [m]; a level camera is
            assumed if the floor is unknown.
        corners_world: Outline in the world, ``(4, 2)`` float64, X and Y [m]; None without a pose or
            a floor.
        num_points: Number of depth cells; in the preset ``paper`` number of corners.
        evidence: How the obstacle was detected: ``surface``; ``free_floor`` for a low object in a
            notch of the free floor; ``corners`` in the preset ``paper``.
    """

    label: int
    distance_m: float | None
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
    evidence: str
    frame: "FrameResult"

    def __repr__(self) -> str:
        high = "" if self.top_m is None else f", {self.bottom_m:.2f} to {self.top_m:.2f} m high"
        away = distance_text(self.distance_m, float(self.xyz_min[2]))
        return f"<Obstacle {self.label}: {away} away{high}, box {self.box}>"

    @property
    def points(self) -> np.ndarray:
        """Points in the camera optical frame, ``(num_points, 3)`` float32 [m]."""
        return self.frame.points[self.frame.point_labels == self.label]

    def mask(self) -> np.ndarray:
        """Return the mask of the obstacle, ``(H, W)`` bool, see :attr:`FrameResult.labels`."""
        return self.frame.labels == self.label


_NUMBERS = "distance_m", "bottom_m", "top_m", "num_points"
_SIDES = "u_min", "v_min", "u_max", "v_max"


class FrameResult(Sequence[Obstacle]):
    """Result of a frame: a sequence of obstacles in the order of their labels.

    The result keeps all arrays of the batch in memory, including images: 1.3 MB per frame without
    colour.
    """

    def __init__(self, batch: "BatchResult", row: int) -> None:
        self._batch, self._row = batch, row

    @overload
    def __getitem__(self, index: int) -> Obstacle: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Obstacle, ...]: ...
    def __getitem__(self, index: Any) -> Any:
        """Return the obstacle with a label, or the obstacles in a slice."""
        return self.obstacles[index]

    def __len__(self) -> int:
        return self._batch.counts[self._row]

    def __repr__(self) -> str:
        near = f", the nearest at {self.nearest_text}" if len(self) else ""
        return f"<FrameResult {self.number}: {self.status}, {len(self)} obstacles{near}>"

    def _repr_png_(self) -> bytes:
        """Return the picture shown in notebooks."""
        import cv2

        picture = cv2.cvtColor(self.draw(), cv2.COLOR_RGB2BGR)
        return cv2.imencode(".png", picture)[1].tobytes()

    def to_pandas(self) -> "pd.DataFrame":
        """Return a pandas table with one row per obstacle.

        Columns are ``obstacle``, ``distance_m``, ``bottom_m``, ``top_m``, ``num_points``, the box
        ``u_min`` ... ``v_max`` and the centroid ``x y z`` in the camera's optical frame [m].
        """
        import pandas as pd

        boxes = [one.box or (None,) * 4 for one in self]
        columns = {name: [getattr(one, name) for one in self] for name in _NUMBERS}
        sides = dict(zip(_SIDES, zip(*boxes, strict=True) if boxes else [()] * 4, strict=True))
        middles = np.array([one.centroid for one in self], np.float32).reshape(-1, 3)
        places = dict(zip("xyz", middles.T, strict=True))
        labels = {"obstacle": [one.label for one in self]}
        found = pd.DataFrame({**labels, **columns, **sides, **places})
        return found.astype(dict.fromkeys(_SIDES, "Int32"))

    @property
    def number(self) -> int:
        """Frame number in the log or in the batch, from 0."""
        return int(self._batch.frames.number[self._row])

    @property
    def stamp_ns(self) -> int:
        """Timestamp of the depth image [ns]."""
        return int(self._batch.frames.stamp_ns[self._row])

    @property
    def status(self) -> FrameStatus:
        """``ok``, or the reason why there is no result, for instance ``no_depth``."""
        return FrameStatus(self._column("status"))

    @property
    def error(self) -> str:
        """Reason why a frame of a log is unusable, else empty."""
        return self._batch.errors[self._row]

    @cached_property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """Obstacles, in the order of their labels."""
        return tuple(self._batch.obstacles_of(self, self._row))

    @property
    def nearest_m(self) -> float | None:
        """Distance of the nearest obstacle [m]; None if there is none, or the floor is unknown."""
        distances = (obstacle.distance_m for obstacle in self.obstacles)
        return min((d for d in distances if d is not None), default=None)

    @property
    def nearest_text(self) -> str:
        """Text of the nearest obstacle's distance, or of its depth after ``~`` without a floor."""
        depths = [float(obstacle.xyz_min[2]) for obstacle in self.obstacles]
        return distance_text(self.nearest_m, min(depths)) if depths else ""

    @property
    def floor(self) -> Mount | None:
        """Camera pose relative to the floor in use; None if the floor is unknown."""
        plane = self._batch.rows.plane
        if not plane.valid[self._row]:
            return None
        return Mount(*(float(part[self._row]) for part in plane[:3]))

    @property
    def floor_source(self) -> str:
        """Source of the floor: ``frame`` (its own depth), ``mount`` (the prior) or ``none``.

        For frames of a log also ``window``, ``log``, ``tf`` or ``flags``, as in ``frames.parquet``.
        """
        return str(self._column("floor_source"))

    @property
    def floor_refused(self) -> str | None:
        """Reason why the frame's floor was refused, a :class:`jaxdet.types.Refusal`, or None."""
        reason = self._column("floor_refused")
        return None if reason is np.ma.masked else str(reason)

    @property
    def overflow(self) -> bool:
        """Whether obstacles may be missing because a limit was exceeded.

        The limits are the maximum numbers of obstacles and surfaces or, in the preset ``paper``, of
        corners.
        """
        return bool(self._column("overflow"))

    @property
    def free_floor(self) -> FreeFloorLine | None:
        """Free floor; None in the preset ``paper`` and for unusable frames."""
        names = ("free_bearing_rad", "free_from_m", "free_to_m", "free_end")
        lists: list[Lists] = [self._batch.rows.frames[name] for name in names]
        if lists[0].null[self._row]:
            return None
        start, stop = lists[0].offsets[self._row : self._row + 2]
        return FreeFloorLine(*(part.values[start:stop] for part in lists))

    @property
    def drop_m(self) -> float | None:
        """Distance of the nearest drop [m], or None if no drop is visible."""
        value = float(self._column("drop_m"))
        return None if np.isnan(value) else value

    @cached_property
    def labels(self) -> np.ndarray:
        """Obstacle label per pixel, ``(H, W)`` int32, -1 = none, in the image of the boxes.

        Labels have the resolution of depth cells (3 to 4 pixels of a depth image). If several cells
        cover a pixel, the nearest one is used.

        Raises:
            ConfigError: The preset is ``paper``, which has no masks.
        """
        cells = self._batch.found.cells
        if cells is None:
            raise ConfigError("the preset paper has no masks", remedy="use another preset")
        calibration, config = self._batch.frames.calibration, self._batch.config
        if not len(self):
            camera = calibration.image
            return np.full((camera.height, camera.width), -1, np.int32)
        side = cell_side(calibration.depth, config.surface.cell_rad)
        return label_image(cells, self._row, calibration, side)

    @property
    def points(self) -> np.ndarray:
        """Points of all obstacles in the camera's optical frame, ``(P, 3)`` float32 [m]."""
        return self._labelled[0]

    @property
    def point_labels(self) -> np.ndarray:
        """Obstacle label of each point, ``(P,)`` int32."""
        return self._labelled[1]

    @cached_property
    def _labelled(self) -> tuple[np.ndarray, np.ndarray]:
        detections, row = self._batch.found, self._row
        if not len(self):
            return np.zeros((0, 3), np.float32), np.zeros(0, np.int32)
        return obstacle_points(detections, row, self._batch.frames.calibration.depth_unit)

    def draw(self, color: Any = None) -> np.ndarray:
        """Draw a picture as ``jaxdet run`` does.

        Args:
            color: Colour image of the frame; None: the colour image passed to the detector, else
                the depth image in false colours.

        Returns:
            Picture ``(h, w, 3)`` uint8, RGB, about 1280 pixels wide.
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
    """Result of a batch: a sequence of frame results, with their arrays.

    Attributes:
        frames: Frames; ``frames.plane`` is the floor of each frame.
        found: Detections as NumPy arrays with a padded axis, see :class:`jaxdet.Detections`.
        rows: Columns of the tables of frames and obstacles.
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

    def _repr_html_(self) -> str:
        """Return the table of frames shown in notebooks."""
        columns = {
            "frame": [one.number for one in self],
            "status": [one.status for one in self],
            "obstacles": self.counts,
            "nearest": [one.nearest_text for one in self],
            "floor from": [one.floor_source for one in self],
        }
        return table(repr(self).strip("<>"), columns)

    def to_pandas(self) -> "pd.DataFrame":
        """Return a pandas table of the obstacles of all frames, with the column ``frame``."""
        import pandas as pd

        each = [one.to_pandas() for one in self]
        found = pd.concat(each, ignore_index=True)
        found.insert(0, "frame", np.repeat([one.number for one in self], self.counts))
        return found

    @overload
    def __getitem__(self, index: int) -> FrameResult: ...
    @overload
    def __getitem__(self, index: slice) -> list[FrameResult]: ...
    def __getitem__(self, index: Any) -> Any:
        """Return the result of a frame by its index in the batch, or the results in a slice."""
        rows = range(len(self))[index]
        if isinstance(rows, range):
            return [FrameResult(self, row) for row in rows]
        return FrameResult(self, rows)

    def obstacles_of(self, frame: FrameResult, row: int) -> Iterator[Obstacle]:
        """Yield the obstacles of a frame from their rows."""
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
                distance_m=_known(columns["distance_m"][at]),
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
                evidence=str(columns["evidence"][at]),
                frame=frame,
            )


def _known(value: np.floating) -> float | None:
    return None if np.isnan(value) else float(value)
