"""Frames in memory, shared among worker processes."""

from collections.abc import Generator, Iterable, Iterator
from typing import Any

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.pool import Pool, usual_count
from jaxdet.pipeline import BackendName, detect, floor_of
from jaxdet.results.rows import to_host
from jaxdet.types import Detections, Frames, GroundPlane


class Workers:
    """Processes that find obstacles in frames in memory; a context manager.

    Warp calls back under one lock on the CPU, so a process uses about one core; these use them
    all, with arrays equal to those of :func:`jaxdet.detect`. A script that uses them needs
    ``if __name__ == "__main__":``, as every worker imports it.

    Args:
        count: Number of processes; by default one a core on the CPU, one on a GPU.
        config: The method's parameters; by default the preset ``wheeled``.
        backend: As for :func:`jaxdet.detect`.

    Raises:
        ConfigError: ``count`` is below 1.
    """

    def __init__(
        self, count: int | None = None, config: Config | None = None, backend: BackendName = "jax"
    ) -> None:
        self.config = config or Config()
        self.backend: BackendName = backend
        self._pool = Pool(usual_count(backend) if count is None else count)

    def __enter__(self) -> "Workers":
        """The workers themselves."""
        return self

    def __exit__(self, *_: object) -> None:
        """Ends the processes."""
        self.close()

    def close(self) -> None:
        """Ends the processes."""
        self._pool.close()

    def map(self, batches: Iterable[Frames]) -> Generator[Detections, None, None]:
        """Yields ``detect(batch)`` of each batch, in order, as NumPy arrays.

        Batches are taken as workers become free. Equal shapes save compilations.

        Raises:
            WorkerError: A worker died, or failed in a way that nobody foresaw.
            JaxdetError: As :func:`jaxdet.detect` raises it.
        """
        return self._pool.map(_DetectJob(self.config, self.backend), batches)

    def detect(self, frames: Frames, batch_size: int = 16) -> Detections:
        """``detect(frames)`` for any number of frames, as NumPy arrays.

        Args:
            frames: ``B`` frames; what the workers get of them is in batches, the last padded.
            batch_size: Frames that a worker computes together; changes no result.

        Returns:
            What :func:`jaxdet.detect` returns for all the frames together.

        Raises:
            ValueError: There are no frames, or ``batch_size`` is below 1.
        """
        if batch_size < 1 or not len(frames.depth):
            raise ValueError(f"{len(frames.depth)} frames in batches of {batch_size}")
        frames = frames._replace(
            T_world_camera=None, plane=floor_of(frames, self.config, backend=self.backend)
        )
        found = list(self.map(_batches(frames, batch_size)))
        return _joined(found, len(frames.depth))


class _DetectJob:
    """A batch of frames to its detections."""

    def __init__(self, config: Config, backend: BackendName) -> None:
        self.config = config
        self.backend: BackendName = backend

    def __call__(self, frames: Frames) -> Detections:
        return to_host(detect(frames, self.config, backend=self.backend))

    def where(self, frames: Frames) -> str:
        numbers = np.asarray(frames.number)[np.asarray(frames.valid)].tolist()
        return f"frames {numbers[0]} to {numbers[-1]}" if numbers else "no frames"

    def close(self) -> None:
        pass


def _batches(frames: Frames, size: int) -> Iterator[Frames]:
    """The frames, ``size`` at a time; the last batch is padded as a log's is."""
    plane = frames.plane
    assert plane is not None
    for start in range(0, len(frames.depth), size):

        def rows(values: np.ndarray, start: int = start, **padding: Any) -> np.ndarray:
            part = np.asarray(values)[start : start + size]
            missing = size - len(part)
            if not missing:
                return part
            return np.pad(part, [(0, missing)] + [(0, 0)] * (part.ndim - 1), **padding)

        stamps = {name: rows(getattr(frames, name), constant_values=-1) for name in _STAMPS}
        images = {name: rows(getattr(frames, name)) for name in ("color", "depth", "valid")}
        repeated = GroundPlane(*(rows(values, mode="edge") for values in plane))
        yield frames._replace(**images, **stamps, plane=repeated)


_STAMPS = ("number", "stamp_ns", "depth_stamp_ns")


def _joined(parts: list[Any], count: int) -> Any:
    """Named tuples of arrays, or None, one after the other, cut to ``count`` rows."""
    if parts[0] is None:
        return None
    if isinstance(parts[0], np.ndarray):
        return np.concatenate(parts)[:count]
    fields = zip(*parts, strict=True)
    return type(parts[0])(*(_joined(list(field), count) for field in fields))
