"""What is done with a batch of a log, in this process or in a worker."""

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.ground import Planes
from jaxdet.pipeline import BackendName, detect
from jaxdet.render import draw_frame, write_png
from jaxdet.results.free_floor import Polygons
from jaxdet.results.metric import rectangles
from jaxdet.results.rows import batch_rows, row_inputs, to_host
from jaxdet.types import Detections, GroundPlane

if TYPE_CHECKING:
    from jaxdet.engine.scoring import Scorer
    from jaxdet.eval import Tally
    from jaxdet.io import Batch, Log


class LogJob(NamedTuple):
    """What holds for all batches of a log; decided before the first of them."""

    name: str
    """The log's name."""
    config: Config
    backend: BackendName
    batch_size: int
    planes: Planes
    drawn: frozenset[int]
    """Frames to draw."""
    folder: Path
    """Where pictures go."""
    file_name: str
    """What their names begin with."""
    truth: Path | None
    """A simulated log whose truth the detections are compared with."""


class Started(NamedTuple):
    """A batch whose detections may still be computed."""

    batch: "Batch"
    plane: GroundPlane
    """The floor given to each frame."""
    sources: list[str]
    """Where it comes from."""
    detections: Detections


class Done(NamedTuple):
    """What a batch leaves behind, without its images."""

    frames: dict[str, Any]
    """Columns of ``frames.parquet``."""
    obstacles: dict[str, Any]
    """Columns of ``obstacles.parquet``."""
    T_world_camera: np.ndarray | None
    """``(B, 4, 4)`` float64."""
    free_world: Polygons | None
    """See :class:`jaxdet.results.rows.Rows`."""
    errors: list[str]
    """Frames that could not be used, with the reason."""
    pictures: list[str]
    """Names of the pictures drawn."""
    tally: "Tally | None"
    """Comparison with the truth."""


class LogWork:
    """Reads, detects, makes rows, draws and compares; a :class:`jaxdet.engine.worker.Job`.

    Args:
        log: An open log.
        job: What to do.
    """

    def __init__(self, log: "Log", job: LogJob) -> None:
        self.log, self.job = log, job

    def __call__(self, first: int) -> Done:
        """The batch that begins with frame ``first``."""
        stop = min(first + self.job.batch_size, self.log.num_frames)
        (batch,) = self.log.batches(self.job.batch_size, first, stop)
        return self.finish(self.start(batch))

    def where(self, first: int) -> str:
        """The log and the frames of a batch."""
        last = min(first + self.job.batch_size, self.log.num_frames) - 1
        return f"{self.job.name}, " + (
            f"frames {first} to {last}" if last > first else f"frame {last}"
        )

    def close(self) -> None:
        """Closes the log."""
        self.log.close()

    def start(self, batch: "Batch", **on_device: Any) -> Started:
        """Starts the detection.

        Args:
            batch: What was read.
            on_device: Its images on a device, where they are there already.
        """
        stamps, planes = batch.frames.stamp_ns, self.job.planes
        plane = planes.of(stamps)
        frames = batch.frames._replace(plane=plane, **on_device)
        found = detect(frames, self.job.config, backend=self.job.backend)
        _copy_to_host(found)
        return Started(batch, plane, planes.sources(stamps), found)

    def finish(self, started: Started) -> Done:
        """Waits for the detections and uses them."""
        batch, plane, sources, found = started
        found = to_host(found)
        given = self.job.name, batch, plane, sources
        rows = batch_rows(*given, row_inputs(found), self.job.config)
        numbers = batch.frames.number.tolist()
        errors = [f"frame {i}: {e}" for i, e in zip(numbers, batch.errors, strict=False) if e]
        tally = self._scorer.tally(batch, found) if self._scorer else None
        return Done(
            rows.frames,
            rows.obstacles,
            batch.frames.T_world_camera,
            rows.free_world,
            errors,
            self._draw(batch, found, rows.plane),
            tally,
        )

    @cached_property
    def _scorer(self) -> "Scorer | None":
        if self.job.truth is None:
            return None
        from jaxdet.engine.scoring import Scorer  # which loads the simulator

        return Scorer(self.job.truth, self.job.config)

    def _draw(self, batch: "Batch", found: Detections, plane: GroundPlane) -> list[str]:
        frames, config = batch.frames._replace(plane=plane), self.job.config
        unit, drawn = frames.calibration.depth_unit, []
        for row, index in enumerate(frames.number[: len(batch.status)].tolist()):
            if index in self.job.drawn and frames.valid[row]:
                name = f"pictures/{self.job.file_name}_{index:06d}.png"
                title = f"{self.job.name}   frame {index}"
                corners = rectangles(found.obstacles, unit, config.footprint)
                picture = draw_frame(frames, found, corners, row, config, title)
                path = self.job.folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                write_png(path, picture)
                drawn.append(name)
        return drawn


def _copy_to_host(found: Any) -> None:
    """Starts to copy results, so that they are there when they are asked for."""
    for part in found:
        if isinstance(part, tuple):
            _copy_to_host(part)
        elif hasattr(part, "copy_to_host_async"):
            part.copy_to_host_async()
