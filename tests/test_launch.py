"""CUDA's launches and devices, as far as they can be seen without a GPU."""

import threading
import time
from types import SimpleNamespace
from typing import Any, cast

import jax
import numpy as np
import pytest

from jaxdet import detect
from jaxdet.errors import ConfigError
from jaxdet.stages import _launch
from tests.scenes import blocks, frames, level, small, smooth_depth


def test_streams_of_several_devices_are_made_one_at_a_time(monkeypatch):
    """Warp enters them into a table that has no lock."""
    made, making, together = [], [], []

    def stream(device: int, cuda_stream: int) -> tuple[int, int]:
        making.append(device)
        time.sleep(0.02)
        together.append(len(making))
        making.remove(device)
        made.append((device, cuda_stream))
        return made[-1]

    monkeypatch.setattr(_launch.wp, "Stream", stream)
    threads, launched = [], []
    for device in range(4):
        launch = _launch._Launch(cast(Any, None), (), {}, {}, {})
        recorded: Any = SimpleNamespace(device=device, launch=launched.append)
        launch.recorded[device] = recorded, [], {}
        threads.append(threading.Thread(target=launch.run, args=([], device, 7 + device)))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert together == [1] * 4
    assert sorted(made) == sorted(launched) == [(device, 7 + device) for device in range(4)]


@pytest.mark.parametrize("capability", ["7.5", "6.1"])
def test_a_gpu_of_an_earlier_kind_is_refused_in_one_line(monkeypatch, capability):
    old = SimpleNamespace(device_kind="Tesla T4", compute_capability=capability)
    monkeypatch.setattr(jax, "local_devices", lambda: [old])
    images = blocks(1, 60, 80), smooth_depth(1, small().depth)
    with jax.default_device(None), pytest.raises(ConfigError) as caught:
        detect(frames(small(), *map(np.asarray, images), plane=level(1)))
    text = str(caught.value)
    assert "Tesla T4" in text and capability in text and "JAX_PLATFORMS=cpu" in text
    assert "\n" not in text
