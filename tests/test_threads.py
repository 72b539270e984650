"""CPU kernels on several cores: equal results for any number of threads, and errors."""

import os
import signal
import threading
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
import pytest

import jaxdet.cores
from jaxdet import detect, reference
from jaxdet.cores import cores
from jaxdet.runtime import launch
from jaxdet.runtime import threads as pool
from jaxdet.signals import stops_held_back
from tests.scenes import (
    align_all,
    assert_equal,
    blocks,
    frames,
    level,
    noise_depth,
    small,
    smooth_depth,
)

pytestmark = pytest.mark.twin

BATCHES = pytest.mark.parametrize("batch", [1, 3, 7])


@pytest.fixture(params=[1, 3])
def threads(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Set the number of threads, and clear programs traced for another number."""
    monkeypatch.setenv("PJRT_NPROC", str(request.param))
    pool._pool.cache_clear()
    jax.clear_caches()
    yield request.param
    monkeypatch.undo()
    pool._pool.cache_clear()
    jax.clear_caches()


@BATCHES
def test_alignment_does_not_depend_on_the_number_of_threads(threads, batch):
    calibration = small(320, 240)
    for image in noise_depth, smooth_depth:
        depth = image(batch, calibration.depth)
        assert_equal(align_all(depth, calibration), reference.paper.align(depth, calibration))


@BATCHES
def test_results_do_not_depend_on_the_contents_of_scratch_memory(threads, batch):
    """Scratch memory is filled with other values before each batch."""
    calibration = small(64, 48)
    for start in 0, batch:
        depth = np.roll(noise_depth(2 * batch, calibration.depth), start, axis=0)[:batch]
        images = blocks(2 * batch, 48, 64)[start : start + batch]
        given = frames(calibration, images, depth, plane=level(batch, 0.3))
        for memory in launch._kept.values():
            memory.fill_(0x5A5A5A5A)
        assert_equal(detect(given), detect(given, backend="reference"))


@BATCHES
def test_the_pipeline_does_not_depend_on_the_number_of_threads(threads, batch):
    calibration = small(96, 61)
    depth = noise_depth(batch, calibration.depth)
    given = frames(calibration, blocks(batch, 61, 96), depth, plane=level(batch, 0.3))
    assert_equal(detect(given), detect(given, backend="reference"))


def test_each_core_has_its_own_thread(threads):
    """The threads run at the same time, as each waits for all others."""
    together, names = threading.Barrier(threads, timeout=30.0), set()

    def waits() -> None:
        names.add(threading.get_ident())
        together.wait()

    pool.on_all_cores([waits] * threads)
    assert len(names) == threads


def test_an_error_in_a_thread_reaches_the_caller(monkeypatch):
    monkeypatch.setenv("PJRT_NPROC", "2")
    pool._pool.cache_clear()
    depth = noise_depth(4, small().depth)

    def fails() -> None:
        raise ArithmeticError("in a thread")

    with pytest.raises(ArithmeticError, match="in a thread"):
        pool.on_all_cores([lambda: None, fails])
    plain = pool.on_all_cores
    with monkeypatch.context() as patch:
        patch.setattr(pool, "on_all_cores", lambda work: plain([work[0], fails]))
        with pytest.raises(jax.errors.JaxRuntimeError, match="in a thread"):
            jax.block_until_ready(align_all(depth, small()))
    assert_equal(align_all(depth, small()), reference.paper.align(depth, small()))


def test_the_number_of_threads_is_that_of_cores_unless_set_for_xla(monkeypatch):
    monkeypatch.delenv("PJRT_NPROC", raising=False)
    assert pool.threads() == cores()
    monkeypatch.setenv("PJRT_NPROC", "3")
    assert pool.threads() == 3


@pytest.mark.parametrize(
    ("text", "most"),
    [("150000 100000", 2), ("20000 100000", 1), ("100000000 100000", 64), ("max 100000", 64)],
)
def test_cores_of_a_control_group_are_rounded_up(tmp_path, monkeypatch, text, most):
    """A limit of 1.5 cores counts as two: a core may be idle at times, but none is unused."""
    monkeypatch.setattr(jaxdet.cores, "_QUOTA", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(64)), raising=False)
    assert cores() == 64  # no such file
    (tmp_path / "cpu.max").write_text(f"{text}\n")
    assert cores() == most


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="threads have no affinity")
def test_a_cpu_affinity_set_later_by_the_caller_is_kept(monkeypatch):
    allowed = os.sched_getaffinity(0)
    monkeypatch.setenv("PJRT_NPROC", str(len(allowed)))
    pool._pool.cache_clear()
    depth = noise_depth(4, small().depth)
    jax.block_until_ready(align_all(depth, small()))
    chosen = {min(allowed)}
    try:
        os.sched_setaffinity(0, chosen)
        pool.on_all_cores([lambda: None] * 2)
        assert os.sched_getaffinity(0) == chosen
    finally:
        os.sched_setaffinity(0, allowed)
        pool._pool.cache_clear()


def test_an_interrupt_is_deferred_to_the_end_of_a_program(monkeypatch):
    """XLA calls kernels in the thread of the caller, where Python raises KeyboardInterrupt."""
    calibration = small(48, 36)
    depth = smooth_depth(2, calibration.depth)
    images = frames(calibration, blocks(2, 36, 48), depth, plane=level(2))
    want, done, plain = detect(images, backend="reference"), [], pool.on_all_cores

    def interrupted(work: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        plain(work)
        done.append(True)

    assert_equal(detect(images), want)
    with monkeypatch.context() as patch:
        patch.setattr(pool, "on_all_cores", interrupted)
        with pytest.raises(KeyboardInterrupt):
            detect(images)
    assert done
    assert_equal(detect(images), want)


def test_the_engine_finishes_a_batch_before_an_interrupt():
    done = False
    with pytest.raises(KeyboardInterrupt), stops_held_back():
        signal.raise_signal(signal.SIGINT)
        done = True
    assert done
