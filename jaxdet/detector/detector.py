"""Detector of obstacles in frames in memory."""

# With this import, help() shows ArrayLike instead of its union.
from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from jaxdet.arguments import numbers, of_type, whole_number
from jaxdet.checks import MAX_FRAMES
from jaxdet.config import Config
from jaxdet.config_file import ConfigSource, find_config
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
from jaxdet.floor.plane import floor_prior, join_planes, repeat_plane, unknown_plane
from jaxdet.pipeline import BackendName, detect, estimate_plane
from jaxdet.results.rows import batch_rows, row_inputs, to_host
from jaxdet.types import Calibration, Detections, Extrinsics, Frames, GroundPlane, Intrinsics

if TYPE_CHECKING:
    from jaxdet.engine import Planes
    from jaxdet.io import Batch, Log

RUN_BATCH = 16
"""Default number of frames per batch of a log."""


class Detector:
    """Detector of obstacles in depth images of a camera, equal to ``jaxdet run``.

    Only depth is used; colour is for pictures and for the preset ``paper``. The floor is estimated
    from the depth of each frame, near the ``mount`` if there is one. Results do not depend on the
    batch size, and the detector has no state between frames. It may be called from one thread at a
    time.

    Args:
        K: Camera of the depth images: a matrix ``(3, 3)`` or ``fx fy cx cy`` [pixel] for images
            without distortion, or :class:`jaxdet.Intrinsics` with a lens model. If depth is aligned
            to colour, this is the colour camera.
        color_K: Colour camera in the form of ``K``, if colour images are not aligned with depth;
            boxes then refer to the colour image. It must be :class:`jaxdet.Intrinsics` unless the
            first frame has a colour image. None: colour is aligned with depth, or unused.
        T_color_depth: Transform ``(4, 4)`` from the depth camera's optical frame to the colour
            camera's [m], or :class:`jaxdet.Extrinsics`; required with ``color_K``.
        depth_unit_m: Metres per unit of a uint16 depth image; float depth is in metres and rounded
            to this unit.
        color_order: Channel order of colour images: ``rgb``, or ``bgr`` as in OpenCV.
        mount: Camera mounting, the prior of the floor; the depth of each frame corrects it by at
            most ``floor.max_turn_deg`` and ``floor.max_shift_m``. None: the prior of the
            configuration, if any.
        config: Name of a preset, a TOML file, a ``config.json`` of results, a dictionary of
            sections or a :class:`jaxdet.Config`.
        backend: ``jax`` (compiled) or ``reference`` (plain NumPy), with equal results.

    Raises:
        CalibrationError: The calibration is implausible; the error names the argument.
        ConfigError: The preset, file, order or backend is unknown.

    Example:
        >>> detector = Detector([500.0, 500.0, 40.0, 30.0], backend="reference")
        >>> depth = np.full((60, 80), 3.0)  # a wall, 3 m away
        >>> [round(float(obstacle.xyz_min[2]), 2) for obstacle in detector(depth)]
        [3.0]
    """

    config: Config
    """Configuration of the method."""

    def __init__(
        self,
        K: ArrayLike | Intrinsics,
        *,
        color_K: ArrayLike | Intrinsics | None = None,
        T_color_depth: ArrayLike | Extrinsics | None = None,
        depth_unit_m: float = 0.001,
        color_order: ColorOrder = "rgb",
        mount: Mount | None = None,
        config: ConfigSource = "wheeled",
        backend: BackendName = "jax",
    ) -> None:
        one_of("color_order", color_order, ColorOrder)
        one_of("backend", backend, BackendName)
        self.config = find_config(config)
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
        config: ConfigSource = "wheeled",
        backend: BackendName = "jax",
    ) -> Self:
        """Build a detector for the frames of an open log, with its calibration and floor prior.

        As in ``jaxdet run``, the prior of the floor comes from flags (``config.ground``), TF or a
        sample of the log's frames.

        Args:
            log: Log from :func:`jaxdet.open_log`.
            config: See :class:`Detector`.
            backend: See :class:`Detector`.

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
        """Detect the obstacles in one frame.

        Args:
            depth: Depth image ``(Hd, Wd)``, any array-like: uint16 in units of ``depth_unit_m``, 0
                = no measurement, or floats in metres. NaN, infinity, values of 0 or less, and
                masked values of :mod:`numpy.ma` mean "no measurement".
            color: Colour ``(H, W, 3)`` or grey image ``(H, W)``, uint8, for
                :meth:`FrameResult.draw`; the preset ``paper`` finds corners in it.
            mount: Prior of this frame's floor, for instance from an IMU
                (:meth:`Mount.from_gravity`); None: the detector's mount.
            stamp_ns: Timestamp of the frame, an integer [ns], copied to the result. If the detector
                is from a log with ``ground.window_s``, it selects the floor of a time window.
            T_world_camera: Pose ``(4, 4)`` of the depth camera's optical frame in the world [m],
                for :attr:`Obstacle.corners_world`.

        Returns:
            Obstacles in the order of their labels. The images may be overwritten after the call.

        Raises:
            InputError: The type or shape of the images is wrong.
            CalibrationError: The image sizes differ from the calibration.
        """
        poses = None
        if T_world_camera is not None:
            poses = numbers("T_world_camera", T_world_camera, np.float64)[None]
        images = one_frame("depth", depth), None if color is None else one_frame("color", color)
        mounts = None if mount is None else [mount]
        return self.batch(*images, mounts=mounts, stamps_ns=[stamp_ns], T_world_camera=poses)[0]

    def batch(
        self,
        depth: Any,
        color: Any = None,
        *,
        mounts: Sequence[Mount | None] | None = None,
        stamps_ns: ArrayLike | None = None,
        T_world_camera: ArrayLike | Sequence[ArrayLike] | None = None,
    ) -> BatchResult:
        """Detect the obstacles in a batch of ``B`` frames.

        Args:
            depth: Depth images ``(B, Hd, Wd)``, uint16 or floats in metres, or a sequence of them.
            color: Colour ``(B, H, W, 3)`` or grey images ``(B, H, W)``, uint8, or a sequence of
                them; None: no images.
            mounts: Prior of the floor of each frame; None, for a frame or for all: the detector's
                mount.
            stamps_ns: Timestamps ``(B,)``, integers [ns] or datetime64; None: 0.
            T_world_camera: Poses ``(B, 4, 4)``, NaN if unknown; None: all unknown.

        Returns:
            A sequence of the results of the frames, each as from :meth:`__call__`, with the arrays
            of the batch.

        Raises:
            InputError: The type or shape of the images is wrong, or the numbers of frames differ.
            CalibrationError: The image sizes differ from the calibration.
        """
        depths = depth_images(depth, self._cameras.depth_unit_m)
        colors = None if color is None else color_images(color, self._order)
        count = len(depths)
        stamps = times("stamps_ns", [0] * count if stamps_ns is None else stamps_ns)
        poses = None if T_world_camera is None else world_poses(T_world_camera, count)
        if mounts is not None and not isinstance(mounts, Sequence):
            problem = f"expected a list of jaxdet.Mount, got {type(mounts).__name__}"
            raise InputError(problem, topic="mounts")
        for name, values in (("color", colors), ("stamps_ns", stamps), ("mounts", mounts)):
            if values is not None and len(values) != count:
                raise InputError(
                    f"expected {count} entries as for depth, got {len(values)}",
                    topic=name,
                    remedy="pass one per frame",
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
            return self._detect(batch, *self._priors(frames, mounts))

    def run(
        self, log: Log, batch_size: int = RUN_BATCH, *, color: bool = False
    ) -> Iterator[FrameResult]:
        """Detect the obstacles in every frame of the log of :meth:`from_log`.

        The results equal those of ``jaxdet run``; unusable frames have no obstacles, and a status
        other than ``ok``.

        Args:
            log: Log from :func:`jaxdet.open_log`.
            batch_size: Frames per batch; does not change the results.
            color: Whether to read colour images, for :meth:`FrameResult.draw`; the preset ``paper``
                always does.

        Raises:
            InputError: The detector is for another log, or the batch size is below 1.
            RescanError: The log contradicts its index.
        """
        remedy = "create it with Detector.from_log"
        from jaxdet.engine.device import OwnDevice, color_to_read, detected
        from jaxdet.io import Log

        if self._log is None or self._planes is None:
            raise InputError("the detector was not created from a log", topic="log", remedy=remedy)
        of_type("log", log, Log)
        size = whole_number("batch_size", batch_size)
        if size < 1:
            raise InputError(f"must be at least 1, got {size}", topic="batch_size")
        if self._log != (log.label, log.calibration):
            problem = f"the detector was created from {self._log[0]!r}, got {log.label!r}"
            raise InputError(problem, topic="log", remedy=remedy)
        of_type("color", color, bool)
        together = min(size, max(len(log.frames), 1), MAX_FRAMES)
        batches = log.batches(together, **color_to_read(self.config, color))
        device, planes = OwnDevice(self.config, self._backend, with_cells=True), self._planes
        for _, batch, found in detected(((None, batch) for batch in batches), planes, device):
            assert found.detections
            sources = planes.sources(batch.frames.stamp_ns)
            yield from self._results(batch, found.detections, sources)

    def _priors(
        self, frames: Frames, mounts: Sequence[Mount | None] | None
    ) -> tuple[GroundPlane, list[str]]:
        """Return the prior of each frame's floor, and its source."""
        count = len(frames.stamp_ns)
        if self.config.ground.source == "none":
            return unknown_plane(count), ["none"] * count
        mounted = [_checked(mount) or self._mount for mount in mounts or [None] * count]
        if not any(mounted):
            return self._priors_without_mount(frames)
        unknown = unknown_plane(count), ["none"] * count
        others, sources = unknown if all(mounted) else self._priors_without_mount(frames)
        planes = [
            mount.plane if mount else GroundPlane(*(part[row : row + 1] for part in others))
            for row, mount in enumerate(mounted)
        ]
        pairs = zip(mounted, sources, strict=True)
        return join_planes(planes), ["mount" if mount else source for mount, source in pairs]

    def _priors_without_mount(self, frames: Frames) -> tuple[GroundPlane, list[str]]:
        """Return the priors of the log or the configuration, and their sources."""
        if self._planes is not None:
            stamps = frames.stamp_ns
            return self._planes.of(stamps), self._planes.sources(stamps)
        plane, ground = floor_prior(frames, self.config), self.config.ground
        stated = ground.camera_height_m is not None or ground.source == "none"
        if self.config.cluster.points and not stated:
            estimate = estimate_plane(frames, self.config, backend=self._backend)
            plane = repeat_plane(estimate.plane, len(frames.depth))
        return plane, ["mount" if valid else "none" for valid in plane.valid.tolist()]

    def _detect(self, batch: Batch, plane: GroundPlane, sources: list[str]) -> BatchResult:
        from jaxdet.signals import stops_held_back

        frames = batch.frames._replace(plane=plane)
        with stops_held_back():
            detections = detect(frames, self.config, backend=self._backend, with_cells=True)
            detections = to_host(detections)
        return self._results(batch._replace(frames=frames), detections, sources)

    def _results(self, batch: Batch, detections: Detections, sources: list[str]) -> BatchResult:
        """Return the results of a batch with the priors of its floors."""
        plane = batch.frames.plane
        assert plane is not None
        rows = batch_rows("", "", batch, plane, sources, row_inputs(detections), self.config)
        return BatchResult(batch, detections, rows, self.config, self._order)


def _checked(mount: Mount | None) -> Mount | None:
    if mount is not None and not isinstance(mount, Mount):
        got = f"{mount!r}" if isinstance(mount, int | float) else type(mount).__name__
        problem = f"must be a jaxdet.Mount, got {got}"
        raise ConfigError(problem, topic="mount", remedy="pass jaxdet.Mount(height_m, pitch_rad)")
    return mount


def _prepare() -> None:
    """Enable the caches of compiled programs, and start Warp without output."""
    import jax

    from jaxdet.engine import use_caches
    from jaxdet.warp_start import start_warp

    if getattr(jax.config, "jax_compilation_cache_dir", None) is None:
        use_caches()
    start_warp()
