"""End processes right before a chosen system call of a function.

``tests/killed_runs.py`` calls this module, because only a process without threads can fork. Files
are not flushed to the disk: that is slow, and files survive the end of a process without it.
"""

import os
from collections.abc import Callable
from typing import Any

from jaxdet.results import durable

os.fsync = lambda descriptor: None
CALLS = ("replace", "rename", "fsync", "mkdir", "unlink", "rmdir")


def killed_at(call: int, function: Callable[[], Any]) -> bool:
    """Call a function in a child process that ends right before system call number ``call``.

    Returns:
        Whether the function made more than ``call`` system calls, and so was ended.
    """
    child = os.fork()
    if not child:
        count = 0

        def counted(real: Callable[..., Any]) -> Callable[..., Any]:
            def counting(*args: Any, **more: Any) -> Any:
                nonlocal count
                if count == call:
                    os._exit(9)
                count += 1
                return real(*args, **more)

            return counting

        for name in CALLS:
            setattr(os, name, counted(getattr(os, name)))
        durable.exchange = counted(durable.exchange)  # a system call, too
        try:
            function()
        except BaseException:
            import traceback

            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, 9), code
    return code == 9
