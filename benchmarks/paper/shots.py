"""Simulated frames with ground truth, made once by worker processes and stored in files."""

from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.mounts import depth_plane
from benchmarks.paper.files import load, save
from jaxdet.eval import FrameTruth, truth_of
from jaxdet.eval.truth import depth_poses
from jaxdet.floor.plane import flat_plane
from jaxdet.sim import SimConfig, SimFrame, floor_truth, frame_truth, sample_frames, simulate
from jaxdet.sim.config import calibration_of
from jaxdet.types import Calibration, Frames


class Spec(NamedTuple):
    """Frames to simulate: ``frames`` scenes of a family, or a log of ``frames`` frames."""

    family: str
    seed: int
    frames: int
    light: str = "normal"
    changes: tuple[tuple[str, Any], ...] = ()
    """Other fields of :class:`jaxdet.sim.SimConfig`."""
    log: bool = False
    """Whether the frames are a log of one scene, instead of separate scenes."""
    heights: bool = False
    """Whether to store the true heights."""

    @property
    def name(self) -> str:
        """Name of the file, without its extension."""
        parts = [f"{k}={v:.6g}" for k, v in self.changes]
        kind = ["log"] if self.log else []
        high = ["heights"] if self.heights else []
        every = [self.family, self.seed, self.frames, self.light, *parts, *kind, *high]
        return "_".join(map(str, every))


class Shot(NamedTuple):
    """Frame with its ground truth."""

    spec: Spec
    number: int
    color: np.ndarray
    """Colour image ``(H, W, 3)`` uint8, RGB."""
    depth: np.ndarray
    """Depth image ``(Hd, Wd)`` uint16 of the depth camera."""
    calibration: Calibration
    mount: tuple[float, float, float]
    """Height [m], pitch and roll [rad] of the depth camera, as in the TF of a log: without the
    errors of the mount, which the poses include."""
    T_world_camera: np.ndarray
    """Pose of the depth camera, ``(4, 4)`` float64."""
    T_world_color: np.ndarray
    """Pose of the colour camera, ``(4, 4)`` float64."""
    truth: FrameTruth
    """Ground truth of the frame, ``B = 1``; lengths refer to the depth camera."""
    color_truth: FrameTruth
    """The same, but lengths refer to the colour camera, as those of clustered points do."""
    names: tuple[str, ...]
    """Names of the objects."""
    height: np.ndarray | None
    """True height above the floor ``(H, W)`` float16 [m], NaN without an object or floor."""

    @property
    def title(self) -> str:
        """Title with family, light, seed and other settings."""
        own = " ".join(f"{k} {v:.3g}" for k, v in self.spec.changes if k not in ("width", "height"))
        where = f"{self.spec.family} {self.spec.light} seed {self.spec.seed}.{self.number}"
        return f"{where} {own}".strip()


class Store:
    """Simulated frames in files; missing ones are made.

    Args:
        folder: Folder of the files.
        pool: Worker processes; None: frames are made in this process.
    """

    def __init__(self, folder: Path, pool: Executor | None = None) -> None:
        self.folder, self.pool = folder, pool
        self.drawn = 0
        folder.mkdir(parents=True, exist_ok=True)

    def path(self, spec: Spec) -> Path:
        """Return the file of some frames."""
        return self.folder / f"{spec.name}.zst"

    def ensure(self, specs: Iterable[Spec]) -> None:
        """Make missing frames; the same worker makes all lights of a scene."""
        groups: dict[Spec, list[Spec]] = {}
        for spec in specs:
            if not self.path(spec).exists():
                groups.setdefault(spec._replace(light=""), []).append(spec)
        self.drawn += sum(spec.frames for group in groups.values() for spec in group)
        tasks = [(self.folder, tuple(group)) for group in groups.values()]
        list((self.pool.map if self.pool else map)(draw, tasks))

    def load(self, specs: Sequence[Spec]) -> list[Shot]:
        """Return frames; missing ones are made."""
        self.ensure(specs)
        return [shot for spec in specs for shot in load_shots(self.path(spec))]


def load_shots(path: Path) -> list[Shot]:
    """Return the frames in a file that :func:`draw` wrote."""
    return load(path)


def draw(task: tuple[Path, tuple[Spec, ...]]) -> None:
    """Make the files of some frames; task of a worker."""
    folder, specs = task
    for spec in specs:
        save(folder / f"{spec.name}.zst", drawn(spec))


def drawn(spec: Spec) -> list[Shot]:
    """Return simulated frames without reading their file."""
    return [shot_of(spec, frame) for frame in _frames(spec)]


def _frames(spec: Spec) -> Iterable[SimFrame]:
    changes: dict[str, Any] = dict(spec.changes)
    light: Any = spec.light
    if spec.log:
        config = SimConfig(
            scene=spec.family, seed=spec.seed, frames=spec.frames, light=light, **changes
        )
        return simulate(config)
    return sample_frames(spec.family, spec.seed, spec.frames, light=light, **changes)


def shot_of(spec: Spec, frame: SimFrame) -> Shot:
    """Return a simulated frame with its ground truth."""
    truth, config = frame_truth(frame), frame.config
    assert frame.depth is not None
    calibration, floor = calibration_of(config), depth_plane(config)
    images = (
        frame.truth.obstacle_id[None],
        frame.truth.depth[None].astype(np.float16),
        floor_truth(frame).drivable[None],
    )
    return Shot(
        spec,
        frame.number,
        frame.color,
        frame.depth,
        calibration,
        (float(floor.height[0]), float(floor.pitch[0]), float(floor.roll[0])),
        depth_poses(frame.T_world_color[None], calibration)[0],
        frame.T_world_color,
        truth_of(truth, [0], *images, calibration),
        truth_of(truth, [0], *images),
        tuple(truth.names.tolist()),
        frame.truth.height.astype(np.float16) if spec.heights else None,
    )


def frames_of(shots: Sequence[Shot], *, plane: bool = True) -> Frames:
    """Return frames of one camera as a batch.

    Args:
        shots: ``B`` frames.
        plane: Whether to include the floor that follows from the mount of the camera, as from the
            TF of a log; otherwise it is estimated.
    """
    count = len(shots)
    height, pitch, roll = np.array([shot.mount for shot in shots], np.float64).T
    floor = flat_plane(height, pitch, roll) if plane else None
    return Frames(
        np.stack([shot.depth for shot in shots]),
        shots[0].calibration,
        np.arange(count),
        np.zeros(count, np.int64),
        np.ones(count, bool),
        np.stack([shot.color for shot in shots]),
        np.zeros(count, np.int64),
        np.stack([shot.T_world_camera for shot in shots]),
        floor,
    )
