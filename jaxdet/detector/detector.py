"""The detector: a calibration and a configuration, ready for frames."""

# So that help() shows ArrayLike, not the union that it stands for.
from __future__ import annotations

from collections.abc import Iterator, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from jaxdet.arguments import numbers, of_type, whole_number
from jaxdet.checks import MAX_FRAMES
from jaxdet.config import Config
from jaxdet.config_file import find_config
from jaxdet.detector.arguments import (
    Cameras,
    ColorOrder,
    color_images,
    depth_images,
    one_frame,
    one_of,
    times,
    untraced,
    world_poses,
)
from jaxdet.detector.result import BatchResult, FrameResult
from jaxdet.errors import ConfigError, FrameStatus, InputError
from jaxdet.floor.mount import Mount
from jaxdet.floor.plane import join_planes, unknown_plane
from jaxdet.pipeline import BackendName, detect, floor_prior
from jaxdet.results.rows import batch_rows, row_inputs, to_host
from jaxdet.types import Calibration, Extrinsics, Frames, GroundPlane, Intrinsics

if TYPE_CHECKING:
    from jaxdet.engine import Planes
    from jaxdet.io import Batch, Log

RUN_BATCH = 16
"""Frames of a log that are computed together."""


class Detector:
    """Find the obstacles in depth images of one camera, as ``jaxdet run`` does.

    Only depth is read; colour is for pictures and for the preset ``paper``. The floor is searched
    in each frame's own depth, around the ``mount`` where one is given. Results do not depend on how
    many frames are given at once, and nothing is carried from frame to frame. A detector may be
    called from one thread at a time.

    Args:
        K: Camera of the depth images: a matrix ``(3, 3)`` or ``fx fy cx cy`` [pixel] of images
            without distortion, or :class:`jaxdet.Intrinsics`, which can have a lens. Of depth that
            is aligned to colour this is the colour camera.
        color_K: Colour camera in the same form, where colour images have pixels of their own; boxes
            are then in the colour image. :class:`jaxdet.Intrinsics`, unless a colour image comes
            with the first frame. None: colour has the pixels of depth, or there is none.
        T_color_depth: ``(4, 4)``, takes points of the depth camera's optical frame to the colour
            camera's [m]; or :class:`jaxdet.Extrinsics`. Given with ``color_K``.
        depth_unit_m: Metres in a unit of a uint16 depth image; depth in floats is in metres and is
            rounded to this unit.
        color_order: Of the channels of colour images: ``rgb``, or ``bgr`` as OpenCV has them.
        mount: How the camera is mounted, as far as known: each frame's own depth corrects it by at
            most ``floor.max_turn_deg`` and ``floor.max_shift_m``. None: what the configuration
            says, else each frame is searched alone.
        config: Name of a preset, a TOML file, a ``config.json`` of results, or a
            :class:`jaxdet.Config`.
        backend: ``jax``, compiled, or ``reference``, plain NumPy; equal results.

    Raises:
        CalibrationError: No camera has such a calibration; says which argument is wrong.
        ConfigError: There is no such preset, file, order or backend.

    Example:
        >>> detector = Detector([500.0, 500.0, 40.0, 30.0], backend="reference")
        >>> depth = np.full((60, 80), 3.0)  # a wall, 3 m away
        >>> [round(obstacle.distance_m, 2) for obstacle in detector(depth)]
        [3.0]
    """

    config: Config
    """The method's parameters."""

    def __init__(
        self,
        K: ArrayLike | Intrinsics,
        *,
        color_K: ArrayLike | Intrinsics | None = None,
        T_color_depth: ArrayLike | Extrinsics | None = None,
        depth_unit_m: float = 0.001,
        color_order: ColorOrder = "rgb",
        mount: Mount | None = None,
        config: Config | str | PathLike[str] = "wheeled",
        backend: BackendName = "jax",
    ) -> None:
        one_of("color_order", color_order, ColorOrder)
        one_of("backend", backend, BackendName)
        self.config = config if isinstance(config, Config) else find_config(config)
        self._cameras = Cameras(K, color_K, T_color_depth, depth_unit_m)
        self._order: ColorOrder = color_order
        self._backend: BackendName = backend
        self._mount = _checked(mount)
        self._log: tuple[str, Calibration] | None = None
        self._planes: Planes | None = None
        if backend == "jax":
            _prepare()

    def __repr__(self) -> str:
        of = f" of {self._log[0]}" if self._log else ""
        return f"<Detector{of}: {self._cameras}, {self._backend}>"

    @classmethod
    def from_log(
        cls,
        log: Log,
        *,
        config: Config | str | PathLike[str] = "wheeled",
        backend: BackendName = "jax",
    ) -> Self:
        """A detector for the frames of an open log: its calibration, and its floor.

        As ``jaxdet run`` does, it takes what flags (``config.ground``), TF and a sample of the
        log's frames say of the floor as what each frame's floor is looked for around.

        Args:
            log: Of :func:`jaxdet.open_log`.
            config: As above.
            backend: As above.

        Raises:
            InputError: ``ground.source`` is tf and the log has no usable transform.
        """
        from jaxdet.engine import decide_planes
        from jaxdet.io import Log

        of_type("log", log, Log)
        detector = cls(log.calibration.depth, config=config, backend=backend)
        detector._cameras = Cameras.of(log.calibration)
        detector._log = log.label, log.calibration
        detector._planes = decide_planes(log, detector.config, backend)
        return detector

    def __call__(
        self,
        depth: Any,
        color: Any = None,
        *,
        mount: Mount | None = None,
        stamp_ns: int = 0,
        T_world_camera: ArrayLike | None = None,
    ) -> FrameResult:
        """Finds the obstacles in one frame.

        Args:
            depth: ``(Hd, Wd)``, uint16 in units of ``depth_unit_m``, 0 = no measurement, or floats
                in metres, where NaN, infinity and what is not above 0 are no measurement; nor is
                what an array of :mod:`numpy.ma` masks. Anything that NumPy takes as an array.
            color: ``(H, W, 3)`` or grey ``(H, W)``, uint8, for :meth:`FrameResult.draw`; the preset
                ``paper`` finds corners in it.
            mount: What is known of this frame's floor, for instance from an IMU
                (:meth:`Mount.from_gravity`); None: the detector's own.
            stamp_ns: Time of the frame, a whole number [ns], which the result repeats; a detector
                of a log with ``ground.window_s`` has a floor for each time window.
            T_world_camera: ``(4, 4)``, takes points of the depth camera's optical frame to the
                world [m], for :attr:`Obstacle.corners_world`.

        Returns:
            The obstacles, in the order of their labels. The images can be written to again.

        Raises:
            InputError: The images are no such arrays.
            CalibrationError: They are of another size than the calibration.
        """
        poses = None
        if T_world_camera is not None:
            poses = numbers("T_world_camera", T_world_camera, np.float64)[None]
        given = one_frame("depth", depth), None if color is None else one_frame("color", color)
        mounts = None if mount is None else [mount]
        return self.batch(*given, mounts=mounts, stamps_ns=[stamp_ns], T_world_camera=poses)[0]

    def batch(
        self,
        depth: Any,
        color: Any = None,
        *,
        mounts: Sequence[Mount | None] | None = None,
        stamps_ns: ArrayLike | None = None,
        T_world_camera: ArrayLike | Sequence[ArrayLike] | None = None,
    ) -> BatchResult:
        """Finds the obstacles in ``B`` frames, together.

        Args:
            depth: ``(B, Hd, Wd)``, uint16 or floats in metres; or a sequence of frames.
            color: ``(B, H, W, 3)`` or grey ``(B, H, W)``, uint8, or a sequence of frames; None:
                without.
            mounts: What is known of the floor of each; None, of one or of all: the detector's own.
            stamps_ns: ``(B,)`` integers [ns] or datetime64; None: 0.
            T_world_camera: ``(B, 4, 4)``, NaN where unknown; None: not known.

        Returns:
            A sequence of what :meth:`__call__` returns for each, and the arrays behind them.

        Raises:
            InputError: The images are no such arrays, or there are not as many of each.
            CalibrationError: They are of another size than the calibration.
        """
        depths = depth_images(depth, self._cameras.depth_unit_m)
        colors = None if color is None else color_images(color, self._order)
        count = len(depths)
        stamps = times("stamps_ns", [0] * count if stamps_ns is None else stamps_ns)
        poses = None if T_world_camera is None else world_poses(T_world_camera, count)
        if mounts is not None and not isinstance(mounts, Sequence):
            problem = f"{type(mounts).__name__} is no sequence of them"
            raise InputError(problem, topic="mounts", remedy="give a list of jaxdet.Mount")
        for name, of_each in (("color", colors), ("stamps_ns", stamps), ("mounts", mounts)):
            if of_each is not None and len(of_each) != count:
                raise InputError(
                    f"{len(of_each)} for {count} depth images",
                    topic=name,
                    remedy="give one for every frame",
                )
        shape = None if colors is None else colors.shape
        calibration = self._cameras.calibration(depths.shape, shape)
        number, valid = np.arange(count, dtype=np.int64), np.ones(count, bool)
        color_stamps = None if colors is None else stamps
        frames = Frames(
            depths, calibration, number, stamps, valid, colors, color_stamps, T_world_camera=poses
        )
        from jaxdet.io.batch import Batch

        batch = Batch(frames, (FrameStatus.OK,) * count, ("",) * count)
        with untraced():
            return self._found(batch, *self._known(frames, mounts))

    def run(
        self, log: Log, batch_size: int = RUN_BATCH, *, color: bool = False
    ) -> Iterator[FrameResult]:
        """Finds the obstacles in every frame of the log that the detector was made from.

        The results are what ``jaxdet run`` writes, frame by frame; frames that can't be used have
        a status that says so and no obstacles.

        Args:
            log: Of :func:`jaxdet.open_log`.
            batch_size: Frames computed together; changes no result.
            color: Whether to read colour images as well, for :meth:`FrameResult.draw`; the preset
                ``paper`` always does.

        Raises:
            InputError: The detector is of another log, or a batch has no frame.
            RescanError: The log isn't as its index lets expect.
        """
        remedy = "make it with Detector.from_log"
        from jaxdet.engine.color import method_frames
        from jaxdet.io import Log

        if self._log is None:
            raise InputError("the detector was not made from a log", topic="log", remedy=remedy)
        of_type("log", log, Log)
        size = whole_number("batch_size", batch_size)
        if size < 1:
            raise InputError(f"batches of {size}", topic="batch_size", remedy="give 1 or more")
        if self._log != (log.label, log.calibration):
            problem = f"the detector was made from {self._log[0]!r}, not from {log.label!r}"
            raise InputError(problem, topic="log", remedy=remedy)
        of_type("color", color, bool)
        paper = self.config.cluster.points
        together = min(size, max(len(log.frames), 1), MAX_FRAMES)
        for batch in log.batches(together, color=color or paper, need_color=paper):
            if paper:
                batch = batch._replace(frames=method_frames(batch.frames, self.config))
            yield from self._found(batch, *self._known(batch.frames, None))

    def _known(
        self, frames: Frames, mounts: Sequence[Mount | None] | None
    ) -> tuple[GroundPlane, list[str]]:
        """What is known of each frame's floor, and where that comes from."""
        count = len(frames.stamp_ns)
        if self.config.ground.source == "none":
            return unknown_plane(count), ["none"] * count
        told = [_checked(mount) or self._mount for mount in mounts or [None] * count]
        if not any(told):
            return self._known_without(frames)
        nothing = unknown_plane(count), ["none"] * count
        others, sources = nothing if all(told) else self._known_without(frames)
        planes = [
            mount.plane if mount else GroundPlane(*(part[row : row + 1] for part in others))
            for row, mount in enumerate(told)
        ]
        pairs = zip(told, sources, strict=True)
        return join_planes(planes), ["mount" if mount else source for mount, source in pairs]

    def _known_without(self, frames: Frames) -> tuple[GroundPlane, list[str]]:
        """The same where no mount is given."""
        if self._planes is not None:
            stamps = frames.stamp_ns
            return self._planes.of(stamps), self._planes.sources(stamps)
        plane = floor_prior(frames, self.config, backend=self._backend)
        return plane, ["mount" if known else "none" for known in plane.valid.tolist()]

    def _found(self, batch: Batch, plane: GroundPlane, sources: list[str]) -> BatchResult:
        from jaxdet.signals import stops_held_back

        frames = batch.frames._replace(plane=plane)
        with stops_held_back():
            found = detect(frames, self.config, backend=self._backend, with_cells=True)
            found = to_host(found)
        rows = batch_rows("", "", batch, plane, sources, row_inputs(found), self.config)
        return BatchResult(batch, found, rows, self.config, self._order)


def _checked(mount: Mount | None) -> Mount | None:
    if mount is not None and not isinstance(mount, Mount):
        said = f"{mount!r}" if isinstance(mount, int | float) else type(mount).__name__
        raise ConfigError(
            f"{said} is none", topic="mount", remedy="give jaxdet.Mount(height_m, pitch_rad)"
        )
    return mount


def _prepare() -> None:
    """Compiled programs are kept between runs, and Warp writes nothing to standard output."""
    import jax

    from jaxdet.engine import use_caches
    from jaxdet.quiet import quiet_warp

    if getattr(jax.config, "jax_compilation_cache_dir", None) is None:
        use_caches()
    quiet_warp()
