"""Memory and worker processes of a run, and the choice of the executor of a log."""

import logging
from typing import TYPE_CHECKING

from jaxdet.cores import cores
from jaxdet.engine.device import OwnDevice
from jaxdet.engine.executors import Executor, InPool, InProcess, memory_plan
from jaxdet.engine.memory import Memory
from jaxdet.engine.pool import Pool
from jaxdet.engine.settings import RunSettings
from jaxdet.engine.startup import start_up
from jaxdet.memory import size_text

if TYPE_CHECKING:
    from jaxdet.io import Log

LOGGER = logging.getLogger("jaxdet")
FRAMES_WORTH_WORKERS = 500
"""Minimum number of frames for which starting workers is worthwhile; this process finishes a
shorter log before workers have started."""


class Resources:
    """Memory and processes of a run.

    Args:
        settings: Settings of the run.
        pool: Worker processes of this and other runs.
        apart: Whether this process leaves all logs to workers, even if there is only one.

    Attributes:
        memory: Memory and the number of processes that fit into it.
        pool: Worker processes.
        batch: Largest number of frames computed together so far.
        workers: Largest number of processes that shared the logs so far.
    """

    def __init__(self, settings: RunSettings, pool: Pool, *, apart: bool = False) -> None:
        options, devices = settings.options, pool.devices
        workers = options.workers or max(1, cores() - bool(devices))
        largest = settings.log_options.max_chunk_mib << 20
        self.settings, self.pool = settings, pool
        self.memory = Memory(options.memory, workers, len(devices), apart=apart, largest=largest)
        pool.resize(self.memory.workers)
        self.batch, self.workers = options.batch_size or 0, 1
        if options.workers and self.memory.workers < options.workers:
            room = f"{size_text(self.memory.total)} of memory have no room for more"
            LOGGER.warning("%d of %d workers: %s", self.memory.workers, options.workers, room)

    @property
    def workers_wanted(self) -> bool:
        """Whether workers also process few or short logs.

        They do so if the user set their number, if there are GPUs, or if workers are running.
        """
        return bool(self.settings.options.workers or self.pool.devices or self.pool.started)

    def choose(self, log: "Log", memory: Memory) -> Executor:
        """Return the executor of an open log: this process if it has few frames, else all workers.

        Args:
            log: Open log.
            memory: Memory of the run, divided among fewer processes if the log has large chunks.

        Raises:
            InputError: There is no room for one frame.
        """
        # ``apart`` is set if the previous run was killed, perhaps because of one of these logs.
        apart = bool(self.pool.devices) or memory.apart
        short = len(log.frames) < FRAMES_WORTH_WORKERS
        few = short and not apart and not self.workers_wanted
        plan = memory_plan(self.settings, log, memory, 1 if few else memory.workers)
        self.batch = max(self.batch, plan.batch)
        if apart or plan.workers > 1:
            return InPool(self.settings, self.pool, plan)
        if not few:
            self.pool.resize(1)  # there is no memory for others
        backend = self.settings.options.backend
        if backend == "jax":
            start_up()
        device = OwnDevice(self.settings.config, backend, ahead=1)
        return InProcess(self.settings, plan, device)
