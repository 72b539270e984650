"""Helpers for tests of runs with workers: comparison of results, and the CPU in place of a GPU."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import pytest
import warp as wp

from jaxdet.engine import pool
from jaxdet.stages import _upload


def same_results(one: Path, other: Path) -> None:
    """Assert that results are equal, except for times and the checksums of files with times."""
    names = [path.relative_to(one) for path in sorted(one.rglob("*")) if path.is_file()]
    assert names == [p.relative_to(other) for p in sorted(other.rglob("*")) if p.is_file()]
    for name in names:
        if name.name not in ("summary.json", "manifest.json"):
            assert (one / name).read_bytes() == (other / name).read_bytes(), name


def on_this_machine(monkeypatch: pytest.MonkeyPatch, gpus: int = 1) -> list[int]:
    """Use the code for GPUs on the CPU; return a list to which each copy appends its size."""
    copies = []

    def copy(
        to: wp.array, source: wp.array, dest_offset: int = 0, src_offset: int = 0, **more: Any
    ) -> None:
        copies.append(more["count"])
        part = source.numpy().reshape(-1)[src_offset : src_offset + more["count"]]
        to.numpy().reshape(-1)[dest_offset : dest_offset + more["count"]] = part

    def device_from_jax(device: Any) -> wp.Device:
        return wp.get_device("cpu")

    same = {name: getattr(wp, name) for name in ("array", "zeros", "to_jax", "from_jax")}
    names = ("Stream", "synchronize_device", "synchronize_stream")
    nothing = dict.fromkeys(names, lambda device: None)
    stand_in = SimpleNamespace(copy=copy, device_from_jax=device_from_jax, **same, **nothing)
    monkeypatch.setattr(_upload, "wp", stand_in)
    lock = SimpleNamespace(unlock=lambda: None)
    monkeypatch.setattr(_upload, "PageLock", lambda memory, device, block: lock)
    monkeypatch.setattr(_upload, "wait_asleep", lambda device: None)
    monkeypatch.setattr(pool, "gpus", lambda: (jax.devices("cpu")[0],) * gpus)
    return copies
