"""Runs the method over logs and writes a folder of results for each.

A run goes one way, each module calling those below it::

    runner, single_log          arguments; worker processes that outlive a run
    settings                    what all logs of the run share, and its record
    scheduler, output           which logs are done, in which order, and where results go
    resources, memory           how many processes and frames fit in memory
    process_log, log_per_worker a log, from its files to its folder: by this process, or by a worker
    executors, plan, floors     the plan of a log and who works on its units
    pool, worker, tasks         processes that do units or logs, and what happens if one dies
    unit, device                a unit of frames: read, compute, make rows
    device_server, device_queue, shared_slots   with GPUs: this process computes for all workers
    unit_result                 results of units, joined in the order of the frames

Names are loaded when they are used, so that options alone cost no import of JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
