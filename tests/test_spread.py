"""A batch over several devices: equal to one device, for any number of rows."""

from typing import Any

import jax
import numpy as np
import pytest

from jaxdet import detect
from jaxdet.config import Config
from jaxdet.stages import _align_points, _program, _program_cpu
from jaxdet.types import Frames
from tests.scenes import assert_equal, blocks, frames, level, small, smooth_depth


def scene(batch: int) -> Frames:
    calibration = small()
    images = blocks(batch, 60, 80), smooth_depth(batch, calibration.depth)
    heights = np.linspace(0.3, 0.5, batch)
    return frames(calibration, *images, plane=level(batch)._replace(height=heights))


@pytest.mark.parametrize("batch", [1, 2, 5])
def test_two_devices_equal_the_reference(monkeypatch, batch):
    """The CUDA program's way over the devices, with the CPU's program in its place."""

    def on_cpu(color, depth, tables, static, unit, config) -> Any:
        return _program_cpu._detect(color, depth, tables, 0, static[0], unit, config)

    def tables(calibration, config) -> Any:
        *arrays, fills = _align_points.tables(calibration)
        return tuple(arrays), (fills,)

    monkeypatch.setattr(_program, "_detect", on_cpu)
    monkeypatch.setattr(_program, "_align_tables", tables)
    assert len(jax.devices("cpu")) == 2
    given, config = scene(batch), Config()
    found = _program.detect(given, given.plane, config)
    assert_equal(found, detect(given, config, backend="reference"))
    if batch == 2:
        shards = found.features.u.addressable_shards
        assert [shard.data.shape[0] for shard in shards] == [1, 1]
        assert [shard.device for shard in shards] == jax.devices("cpu")
