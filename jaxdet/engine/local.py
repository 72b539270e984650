"""The batches of a log in this process: read ahead, and one in flight while another is used."""

from collections.abc import Generator
from contextlib import closing
from typing import TYPE_CHECKING, Any

from jaxdet.engine.batch import Done, LogWork
from jaxdet.engine.prefetch import prefetch

if TYPE_CHECKING:
    from jaxdet.io import Batch

READ_AHEAD = 2
"""Batches that wait, read."""
_HELD = READ_AHEAD + 3
"""Batches whose images are in use: also one being read, one in flight, one being finished."""


def batches_here(work: LogWork) -> Generator[Done, None, None]:
    """Works through a log, in order.

    Each batch is started before the one before it is waited for. On CUDA its images are read
    into page-locked memory and copied on streams of their own.
    """
    upload = None
    reading = work.log.batches(work.job.batch_size)
    if work.job.backend == "jax" and _on_cuda():
        upload = _Upload(work)
        reading = work.log.batches(upload.size, images=upload.ring.images)
    pending = None
    with closing(prefetch(reading, READ_AHEAD)) as batches:
        for batch in batches:
            started = work.start(batch, **(upload(batch) if upload else {}))
            if pending:
                yield work.finish(pending)
            pending = started
        if pending:
            yield work.finish(pending)


class _Upload:
    """Page-locked images for the reader, and their way to the devices."""

    def __init__(self, work: LogWork) -> None:
        from jaxdet.stages._spread import devices_for
        from jaxdet.stages._upload import PinnedRing, Uploader

        parts = len(devices_for(None))
        self.size = -(-work.job.batch_size // parts) * parts
        shapes = [(self.size, *shape) for shape in work.log.image_shapes]
        self.ring = PinnedRing(shapes[0], shapes[1], _HELD)
        self.uploader = Uploader(shapes[0], shapes[1])

    def __call__(self, batch: "Batch") -> dict[str, Any]:
        color, depth = self.uploader.upload(self.ring.pinned(batch.frames.color))
        return {"color": color, "depth": depth}


def _on_cuda() -> bool:
    """Whether frames are worked on by CUDA devices."""
    from jaxdet.stages._device import on_cuda

    return on_cuda()
