"""Runs the method over logs and writes a folder of results for each.

Each module calls those below it::

    runner, single_log           arguments of a run; worker processes that outlive it
    settings, options            configuration and options of a run, and their record in run.json
    scheduler, output            order of the logs; logs that are done; folders of results
    log_job, process_log         processing of a log, from its files to its folder of results
    executors, plan, floors      floors and plan of a log, and the processes that work on its units
    placement, memory            decision which processes work on a log; what fits into memory
    pool, worker, tasks          worker processes, whose tasks are units of a log, or whole logs
    unit, unit_result            processing of a unit: frames are read, computed, made into rows
    device                       where a batch is computed: in this process, or by its parent's GPUs
    gpu_threads, gpu, slots      GPUs of the first process, which compute for all workers

A small log is processed by one worker, a large log by all workers::

    scheduler > pool > worker > LogJob  > process_log > InProcess > UnitProcessor
    scheduler > process_log > InPool > pool > worker > UnitJob > UnitProcessor

Names are imported on first use, so that importing only the options does not import JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
