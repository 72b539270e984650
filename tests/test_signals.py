"""Signals that stop a run: raised where that is safe, with a guard if it never is."""

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from jaxdet.errors import Interrupted
from jaxdet.signals import stops_held_back, stops_raised
from tests.stops import stop, wait_in_jaxdet

GUARDED = """
import ctypes, sys
from jaxdet.signals import end_guard, guard_process, stops_raised
guard_process()
print("ready", flush=True)
{body}
"""
"""Code of a separate process, which runs ``body`` under a guard."""
NATIVE = "with stops_raised():\n    while True: ctypes.CDLL(None).sleep(30)"
"""Body that calls only native code, so that no code of jaxdet runs; the calls release the GIL."""
HELD = """
import os, time
from jaxdet.signals import stops_held_back
try:
    with stops_raised(), stops_held_back():
        print("ready", flush=True)
        time.sleep(0.3)
except KeyboardInterrupt:
    time.sleep(0.3)
    os._exit(7)
"""
"""Code of a process with a block that ends by itself after a signal that it deferred."""


def test_a_signal_is_raised_in_code_of_jaxdet() -> None:
    with pytest.raises(Interrupted) as caught, stops_raised():
        stop(signal.SIGTERM)
    assert caught.value.signal == signal.SIGTERM


def test_a_signal_is_deferred_to_the_end_of_an_import(tmp_path: Path, monkeypatch) -> None:
    code = (
        "import signal, time\nsignal.raise_signal(signal.SIGINT)\ntime.sleep(0.1)\nwhole = True\n"
    )
    (tmp_path / "imported_here.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    whole = False
    with pytest.raises(Interrupted), stops_raised():
        import imported_here

        whole = imported_here.whole
        wait_in_jaxdet()
    assert whole


def test_a_signal_is_not_swallowed_by_a_callback_of_the_garbage_collector() -> None:
    def callback(phase: str, _: object) -> None:
        if phase == "start":
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(Interrupted), stops_raised():
        gc.callbacks.append(callback)
        try:
            gc.collect()
        finally:
            gc.callbacks.remove(callback)
        wait_in_jaxdet()


def test_a_signal_interrupts_a_waiting_thread() -> None:
    condition, start = threading.Condition(), time.monotonic()
    other = threading.Thread(target=time.sleep, args=(5,), daemon=True)
    other.start()
    for wait in (condition.wait, threading.Event().wait, other.join):
        main = threading.main_thread().ident
        threading.Timer(0.05, signal.pthread_kill, (main, signal.SIGINT)).start()
        with pytest.raises(Interrupted), stops_raised(), condition:
            wait(4)
    assert time.monotonic() - start < 3


def test_a_signal_during_a_wait_is_raised_after_the_lock_is_reacquired() -> None:
    """Otherwise the ``with`` around ``Condition.wait`` would release a lock that is not held."""
    code = """
def take_again():
    signal.raise_signal(signal.SIGINT)
    time.sleep(0.1)
    lock.acquire()
"""
    lock = threading.Lock()
    names = {"__name__": "threading", "lock": lock, "signal": signal, "time": time}
    exec(code, names)
    with pytest.raises(Interrupted), stops_raised():
        names["take_again"]()
        assert lock.locked()
        wait_in_jaxdet()
    assert lock.locked()


def test_a_deferred_signal_is_raised_at_the_end_of_the_block() -> None:
    inside = False
    with pytest.raises(Interrupted), stops_raised(), stops_raised():
        signal.raise_signal(signal.SIGINT)
        time.sleep(0.1)
        inside = True
    assert inside
    time.sleep(0.1)  # no second exception follows


def test_a_pending_signal_is_raised_inside_of_the_next_block() -> None:
    with pytest.raises(Interrupted) as caught, stops_raised():
        signal.raise_signal(signal.SIGTERM)
        with stops_raised():
            wait_in_jaxdet()
    assert caught.value.signal == signal.SIGTERM


def test_other_threads_do_not_change_handlers() -> None:
    before, seen = signal.getsignal(signal.SIGINT), []

    def look() -> None:
        with stops_raised(), stops_held_back():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert seen == [before]


@pytest.mark.parametrize(
    ("body", "stops", "code", "most_s"),
    [
        ("import time; time.sleep(30)", 1, 130, 1.4),
        (NATIVE, 1, 130, 5.0),
        (NATIVE, 2, 130, 1.4),
        (HELD, 1, 7, 5.0),
        ("end_guard(); print('ready', flush=True); sys.stdin.read()", 1, 0, 5.0),
    ],
    ids=["before it begins", "in native code", "twice", "held back", "when it is done"],
)
def test_the_guard_ends_a_process_that_does_not_stop(
    body: str, stops: int, code: int, most_s: float
) -> None:
    pipe = subprocess.PIPE
    command = [sys.executable, "-c", GUARDED.format(body=body)]
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
    assert process.stdin and process.stdout
    for _ in range(body.count("ready") + 1):
        process.stdout.readline()
    time.sleep(0.1)
    start = time.monotonic()
    for _ in range(stops):
        os.kill(process.pid, signal.SIGINT)
        time.sleep(0.1)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == code
    assert time.monotonic() - start < most_s
    assert "Traceback" not in errors
