"""A batch over several devices: equal to one device, for any number of rows."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from benchmarks.scene import pin
from jaxdet import detect
from jaxdet.pipeline import find_floors
from jaxdet.presets import PRESETS
from jaxdet.sim import SimConfig, write_log
from jaxdet.stages import _detect, _points, _spread, _upload
from jaxdet.stages._spread import rows_over
from jaxdet.types import Frames, GroundPlane
from tests.runs import only_log, run_logs
from tests.scenes import assert_equal, blocks, frames, level, small, smooth_depth, with_lens


@pytest.fixture(autouse=True)
def all_devices() -> Iterator[None]:
    """None is JAX's default: a batch is shared out to all."""
    with jax.default_device(None):
        yield


def scene(batch: int, lens: str = "pinhole", size: tuple[int, int] = (80, 60)) -> Frames:
    color = with_lens(small(*size).image, lens)
    calibration = small()._replace(color=color)
    images = blocks(batch, color.height, color.width), smooth_depth(batch, calibration.depth)
    heights = np.linspace(0.3, 0.5, batch)
    return frames(calibration, *images, plane=level(batch)._replace(height=heights))


@pytest.mark.parametrize(
    ("name", "batch"), [("wheeled", 1), ("wheeled", 2), ("wheeled", 5), ("paper", 5)]
)
def test_two_devices_equal_the_reference(name, batch):
    assert len(jax.devices("cpu")) == 2
    given, config = scene(batch), PRESETS[name]
    found = detect(given, config)
    assert_equal(found, detect(given, config, backend="reference"))
    if batch == 2 and jax.default_backend() == "cpu":
        shards = found.num_obstacles.addressable_shards
        assert [shard.data.shape[0] for shard in shards] == [1, 1]
        assert [shard.device for shard in shards] == jax.devices("cpu")


@pytest.mark.parametrize(
    ("name", "batches", "compiled"),
    [("wheeled", (5, 4, 3, 2, 1), 4), ("paper", (6, 5), 1)],  # 8, 4, 2 and 1
)
def test_batches_of_all_sizes_are_compiled_for_few(name, batches, compiled):
    program: Any = {"wheeled": _detect._detect, "paper": _points._detect}[name]
    given, config = scene(batches[0]), PRESETS[name]
    want = detect(given, config, backend="reference")
    program.clear_cache()
    with jax.default_device(jax.devices("cpu")[0]):
        for batch in batches:
            some = jax.tree.map(lambda a, batch=batch: a[:batch], want)
            assert_equal(detect(first(given, batch), config), some)
    assert program._cache_size() == compiled


@pytest.mark.parametrize(("name", "devices"), [("wheeled", 1), ("wheeled", 2), ("paper", 2)])
def test_a_batch_in_parts_equals_the_whole(name, devices, monkeypatch):
    given, config = scene(7), PRESETS[name]
    frame = given.depth[0].nbytes + (given.color[0].nbytes if name == "paper" else 0)
    for part in "PART_BYTES", "STAGED_PART_BYTES":
        monkeypatch.setattr(_spread, part, 3 * frame)  # two frames a device
    chosen = jax.devices("cpu")[0] if devices == 1 else None
    with jax.default_device(chosen):
        found = detect(given, config)
        fit = find_floors(given, config)
    assert_equal(found, detect(given, config, backend="reference"))
    assert_equal(fit, find_floors(given, config, backend="reference"))


def test_a_batch_that_is_no_power_of_two_is_not_padded(monkeypatch):
    """Two devices: of 23 frames 16 stay where they are, and 7 get one more."""
    given, sizes = scene(23), []
    bucket = _spread._bucket
    monkeypatch.setattr(
        _spread, "_bucket", lambda *a: sizes.append((a[0], bucket(*a))) or bucket(*a)
    )
    assert_equal(detect(given), detect(given, backend="reference"))
    assert sizes == [(16, 16), (7, 8)]


def first(given: Frames, count: int) -> Frames:
    """The first frames of a batch."""
    fields = {k: a[:count] for k, a in given._asdict().items() if isinstance(a, np.ndarray)}
    plane = None if given.plane is None else GroundPlane(*(a[:count] for a in given.plane))
    return given._replace(**fields, plane=plane)


def runs(path: Path, output: Path, ways: list[tuple[Any, int]]) -> None:
    """Runs of each backend and batch size give the same bytes."""
    for backend, size in ways:
        how = {"backend": backend, "batch_size": size, "workers": 1}
        run_logs(path, output / f"{backend}{size}", **how)
    for name in ("frames.parquet", "obstacles.parquet", "map.npz", "pictures/000000.png"):
        found = {(only_log(output / f"{b}{size}") / name).read_bytes() for b, size in ways}
        assert len(found) == 1, name


@pytest.fixture
def gpus() -> list:
    """All CUDA devices, which are JAX's default then."""
    try:
        return jax.devices("cuda")
    except RuntimeError:
        pytest.skip("no CUDA device")


@pytest.mark.gpu
def test_a_log_through_page_locked_memory_gives_the_bytes_of_the_reference(gpus, tmp_path):
    path = tmp_path / "sim.mcap"
    write_log(path, SimConfig(frames=41, width=320, height=240, device="cuda:0"))
    runs(path, tmp_path, [("reference", 41), ("jax", 1), ("jax", 3), ("jax", 64)])


@pytest.mark.gpu
@pytest.mark.parametrize("name", ["wheeled", "paper"])
@pytest.mark.parametrize(
    ("batch", "lens", "size"),
    [
        (1, "rational", (1920, 1080)),
        (7, "equidistant", (1281, 721)),
        (512, "plumb_bob", (160, 120)),
    ],
)
def test_frames_on_page_locked_memory_equal_the_reference(gpus, name, batch, lens, size):
    given, config = scene(min(batch, 8), lens, size), PRESETS[name]
    want = detect(given, config, backend="reference")
    rows = np.arange(batch) % len(given.color)
    color, depth = given.color[rows], given.depth[rows]
    plane = jax.tree.map(lambda values: values[rows], given.plane)
    want = jax.tree.map(lambda values: np.asarray(values)[rows], want)
    arrays = [(color.shape, np.uint8), (depth.shape, np.uint16)]
    uploader = _upload.Uploader(arrays, gpus[0])
    pinned = pin(color, depth)
    for _ in range(2):
        on_device = uploader.upload([pinned])
        many = frames(given.calibration, *on_device, plane=plane)
        assert_equal(detect(many, config), want)


@pytest.mark.gpu
@pytest.mark.parametrize("name", ["wheeled", "paper"])
@pytest.mark.parametrize("lens", ["pinhole", "equidistant"])
@pytest.mark.parametrize("batch", [1, 5, 16])
def test_all_gpus_share_a_batch(gpus, batch, lens, name):
    if len(gpus) < 2:
        pytest.skip(f"needs 2 GPUs, found {len(gpus)}")
    given, config = scene(batch, lens), PRESETS[name]
    want = detect(given, config, backend="reference")
    found = detect(given, config)
    assert_equal(found, want)
    if batch % len(gpus) == 0:
        assert found.num_obstacles.devices() == set(gpus)
        rows = rows_over(tuple(gpus))
        color, depth = jax.device_put((given.color, given.depth), rows)
        assert color.devices() == set(gpus)
        assert_equal(detect(given._replace(color=color, depth=depth), config), want)
