"""Simulated frames with their truth: drawn once by worker processes, kept in files."""

import pickle
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zstandard

from jaxdet.camera import cell_side
from jaxdet.config import Config
from jaxdet.eval import (
    EvalConfig,
    FrameTruth,
    Tally,
    evaluate_frames,
    in_depth_camera,
    truth_of,
)
from jaxdet.floor.plane import down_vector, plane_from_down
from jaxdet.sim import SimConfig, SimFrame, floor_truth, frame_truth, sample_frames, simulate
from jaxdet.sim.config import calibration_of
from jaxdet.types import Calibration, Detections, Frames


class Spec(NamedTuple):
    """What to draw: ``frames`` scenes of a family by one seed, or a log of ``frames`` frames."""

    family: str
    seed: int
    frames: int
    light: str = "normal"
    changes: tuple[tuple[str, Any], ...] = ()
    """Other fields of :class:`jaxdet.sim.SimConfig`."""
    log: bool = False
    """One scene through time instead of many scenes."""
    heights: bool = False
    """Keep the true heights too."""

    @property
    def name(self) -> str:
        """A file name for it."""
        parts = [f"{k}={v:.6g}" for k, v in self.changes]
        kind = ["log"] if self.log else []
        high = ["heights"] if self.heights else []
        every = [self.family, self.seed, self.frames, self.light, *parts, *kind, *high]
        return "_".join(map(str, every))


class Shot(NamedTuple):
    """One frame and all that is true of it."""

    spec: Spec
    number: int
    color: np.ndarray
    """``(H, W, 3)`` uint8, RGB."""
    depth: np.ndarray
    """``(H, W)`` uint16 on the depth camera's rays."""
    calibration: Calibration
    mount: tuple[float, float, float]
    """Height [m], pitch and roll [rad] of the colour camera, as a log's TF has them: without the
    mount's errors, which ``T_world_camera`` has."""
    T_world_camera: np.ndarray
    """``(4, 4)`` float64, of the colour camera."""
    truth: FrameTruth
    """``B = 1``, lengths refer to the colour camera."""
    names: tuple[str, ...]
    """Of the objects."""
    height: np.ndarray | None
    """``(H, W)`` float16, true height above the floor, NaN where nothing is [m]."""

    @property
    def title(self) -> str:
        """Which frame it is."""
        own = " ".join(f"{k} {v:.3g}" for k, v in self.spec.changes if k not in ("width", "height"))
        where = f"{self.spec.family} {self.spec.light} seed {self.spec.seed}.{self.number}"
        return f"{where} {own}".strip()


class Store:
    """Draws what is asked for and not there yet.

    Args:
        folder: Where the frames are kept.
        pool: Draws; None: this process does.
    """

    def __init__(self, folder: Path, pool: Executor | None = None) -> None:
        self.folder, self.pool = folder, pool
        self.drawn = 0
        folder.mkdir(parents=True, exist_ok=True)

    def path(self, spec: Spec) -> Path:
        """Where its frames lie."""
        return self.folder / f"{spec.name}.zst"

    def ensure(self, specs: Iterable[Spec]) -> None:
        """Draws the missing ones; lights of the same scenes go to the same worker."""
        groups: dict[Spec, list[Spec]] = {}
        for spec in specs:
            if not self.path(spec).exists():
                groups.setdefault(spec._replace(light=""), []).append(spec)
        self.drawn += sum(spec.frames for group in groups.values() for spec in group)
        tasks = [(self.folder, tuple(group)) for group in groups.values()]
        list((self.pool.map if self.pool else map)(draw, tasks))

    def load(self, specs: Sequence[Spec]) -> list[Shot]:
        """Their frames, drawn if need be."""
        self.ensure(specs)
        return [shot for spec in specs for shot in load_shots(self.path(spec))]


def load_shots(path: Path) -> list[Shot]:
    """The frames in a file that this package wrote."""
    return pickle.loads(zstandard.decompress(path.read_bytes()))


def draw(task: tuple[Path, tuple[Spec, ...]]) -> None:
    """Draws specs into their files; a worker's task."""
    folder, specs = task
    for spec in specs:
        shots = drawn(spec)
        part = folder / f"{spec.name}.part"
        part.write_bytes(zstandard.compress(pickle.dumps(shots, protocol=5), 1))
        part.rename(folder / f"{spec.name}.zst")


def drawn(spec: Spec) -> list[Shot]:
    """Its frames, drawn anew."""
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
    """A simulated frame with its truth."""
    truth, config = frame_truth(frame), frame.config
    assert frame.depth is not None
    return Shot(
        spec,
        frame.number,
        frame.color,
        frame.depth,
        calibration_of(config),
        (config.camera_height_m, config.camera_pitch_rad, config.camera_roll_rad),
        frame.T_world_color,
        truth_of(
            truth,
            [0],
            frame.truth.obstacle_id[None],
            frame.truth.depth[None].astype(np.float16),
            floor_truth(frame).drivable[None],
        ),
        tuple(truth.names.tolist()),
        frame.truth.height.astype(np.float16) if spec.heights else None,
    )


def frames_of(shots: Sequence[Shot], *, plane: bool = True) -> Frames:
    """Frames of one camera as a batch.

    Args:
        shots: ``B`` of them.
        plane: Whether the floor is given by the camera's mount on the robot, as a log's TF does;
            else it is left to an estimate.
    """
    count, calibration = len(shots), shots[0].calibration
    height, pitch, roll = np.array([shot.mount for shot in shots], np.float64).T
    T = np.eye(4) if calibration.color_from_depth is None else calibration.color_from_depth.T
    down = down_vector(pitch, roll)
    floor = plane_from_down(down @ T[:3, :3], height - down @ T[:3, 3]) if plane else None
    return Frames(
        np.stack([shot.depth for shot in shots]),
        calibration,
        np.arange(count),
        np.zeros(count, np.int64),
        np.ones(count, bool),
        np.stack([shot.color for shot in shots]),
        T_world_camera=np.stack([shot.T_world_camera for shot in shots]) @ T,
        plane=floor,
    )


def truth_for(found: Detections, shot: Shot, truth: FrameTruth | None = None) -> FrameTruth:
    """Return the truth of a frame in the camera that the lengths of detections refer to.

    Args:
        found: ``B = 1``; of points, which lie in the colour camera, or of depth cells.
        shot: The frame.
        truth: Another truth of the same frame; None: its own.
    """
    truth = shot.truth if truth is None else truth
    if found.points is not None:
        return truth
    return in_depth_camera(truth, shot.T_world_camera[None], shot.calibration)


def tally_of(
    found: Detections,
    shot: Shot,
    config: EvalConfig,
    method: Config,
    truth: FrameTruth | None = None,
) -> Tally:
    """Return the tally of a frame.

    Args:
        found: ``B = 1``, with points or cells.
        shot: The frame.
        config: What counts.
        method: The configuration that it was found with, for the size of cells.
        truth: Another truth of the same frame; None: its own.
    """
    truth, side = truth_for(found, shot, truth), cell_side_of(shot.calibration, method)
    return evaluate_frames(found, truth, shot.calibration, config, None, side)[0]


def cell_side_of(calibration: Calibration, method: Config) -> int:
    """Return the side of a depth cell [pixel]."""
    return cell_side(calibration.depth, method.surface.cell_rad)
