"""Runs the method over logs and writes a folder of results for each.

Each module calls those below it::

    runner                       arguments of a run; worker processes that outlive it
    scheduler, output            order of the logs; logs that are done; folders of results
    process_log                  processing of a log, from its files to its folder of results
    executors                    processes that work on the units of a log
    placement, memory            choice of the processes for a log; batch sizes that fit into memory
    pool, worker                 worker processes, whose tasks are units of a log, or whole logs
    unit, unit_result            processing of a unit: read frames, find obstacles, make table rows
    plan, own_body               units of a log; parts of the robot in the images
    gpu, slots                   GPUs of the main process, which compute for all workers
    device                       detection in batches, in this process or on the main process's GPUs
    floors                       floor priors of a log
    startup                      caches of compiled programs and environment of a process
    settings                     options and configuration of a run, and their record in run.json

A small log is processed by one worker, a large log by all workers::

    scheduler > pool > worker > LogJob  > process_log > InProcess > process_units
    scheduler > process_log > InPool > pool > worker > UnitJob > process_units

Names are imported on first use, so that importing only the options does not import JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
