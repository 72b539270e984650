"""Batches of any size, split or not, on any device, equal the reference."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from benchmarks.scene import pin
from jaxdet import detect
from jaxdet.errors import ConfigError
from jaxdet.presets import PRESETS
from jaxdet.sim import SimConfig, write_log
from jaxdet.stages import _batches, _detect, _upload
from jaxdet.stages.paper import _detect as _paper
from jaxdet.types import Frames, GroundPlane
from tests.runs import only_log, run_logs
from tests.scenes import assert_equal, blocks, frames, level, small, smooth_depth, with_lens

pytestmark = pytest.mark.twin


def scene(batch: int, lens: str = "pinhole", size: tuple[int, int] = (80, 60)) -> Frames:
    color = with_lens(small(*size).image, lens)
    calibration = small()._replace(color=color)
    images = blocks(batch, color.height, color.width), smooth_depth(batch, calibration.depth)
    heights = np.linspace(0.3, 0.5, batch)
    return frames(calibration, *images, plane=level(batch)._replace(height=heights))


@pytest.mark.parametrize("batch", [1, 2, 5, 23])
def test_batches_of_any_size_equal_the_reference(batch):
    given = scene(batch)
    assert_equal(detect(given), detect(given, backend="reference"))


def test_images_on_a_device_are_processed_on_it():
    given, second = scene(2), jax.devices("cpu")[1]
    found = detect(given._replace(depth=jax.device_put(given.depth, second)))
    assert found.num_obstacles.devices() == {second}
    assert_equal(found, detect(given, backend="reference"))


def test_images_spread_over_devices_are_refused():
    given, devices = scene(2), np.array(jax.devices("cpu"))
    rows = NamedSharding(Mesh(devices, ("frames",)), PartitionSpec("frames"))
    with pytest.raises(ConfigError, match="on 2 devices, expected all on one device"):
        detect(given._replace(depth=jax.device_put(given.depth, rows)))


@pytest.mark.parametrize(
    ("name", "batches", "compiled"),
    [("wheeled", (5, 4, 3, 2, 1), 4), ("paper", (6, 5), 1)],  # 8, 4, 2 and 1
)
def test_batch_sizes_are_rounded_up_to_few_compiled_sizes(name, batches, compiled):
    program: Any = {"wheeled": _detect._detect, "paper": _paper._detect}[name]
    given, config = scene(batches[0]), PRESETS[name]
    want = detect(given, config, backend="reference")
    program.clear_cache()
    with jax.default_device(jax.devices("cpu")[0]):
        for batch in batches:
            some = jax.tree.map(lambda a, batch=batch: a[:batch], want)
            assert_equal(detect(first(given, batch), config), some)
    assert program._cache_size() == compiled


@pytest.mark.parametrize(("name", "batch", "part"), [("wheeled", 7, 2), ("paper", 15, 8)])
def test_a_batch_uploaded_in_parts_equals_the_reference(name, batch, part, monkeypatch):
    given, config = scene(batch), PRESETS[name]
    frame = given.depth[0].nbytes + (given.color[0].nbytes if name == "paper" else 0)
    for limit in "PART_BYTES", "STAGED_PART_BYTES":
        monkeypatch.setattr(_batches, limit, (part + 1) * frame)  # rounded down to a power of two
    assert_equal(detect(given, config), detect(given, config, backend="reference"))


def first(given: Frames, count: int) -> Frames:
    """Return the first frames of a batch."""
    fields = {k: a[:count] for k, a in given._asdict().items() if isinstance(a, np.ndarray)}
    plane = None if given.plane is None else GroundPlane(*(a[:count] for a in given.plane))
    return given._replace(**fields, plane=plane)


def runs(path: Path, output: Path, ways: list[tuple[Any, int]]) -> None:
    """Run each backend and batch size, and assert that the results are equal bytes."""
    for backend, size in ways:
        how = {"backend": backend, "batch_size": size, "workers": 1}
        run_logs(path, output / f"{backend}{size}", **how)
    for name in ("frames.parquet", "obstacles.parquet", "map.npz", "pictures/000000.png"):
        found = {(only_log(output / f"{b}{size}") / name).read_bytes() for b, size in ways}
        assert len(found) == 1, name


@pytest.fixture
def gpus() -> list:
    """Return all CUDA devices; skip if there are none."""
    try:
        return jax.devices("cuda")
    except RuntimeError:
        pytest.skip("no CUDA device")


@pytest.mark.gpu
def test_a_log_read_into_page_locked_memory_gives_the_bytes_of_the_reference(gpus, tmp_path):
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
def test_results_of_frames_in_page_locked_memory_equal_the_reference(gpus, name, batch, lens, size):
    given, config = scene(min(batch, 8), lens, size), PRESETS[name]
    want = detect(given, config, backend="reference")
    rows = np.arange(batch) % len(given.color)
    color, depth = given.color[rows], given.depth[rows]
    plane = jax.tree.map(lambda values: values[rows], given.plane)
    want = jax.tree.map(lambda values: np.asarray(values)[rows], want)
    arrays = [(color.shape, np.uint8), (depth.shape, np.uint16)]
    uploader = _upload.Uploader(arrays, gpus[0])
    pinned = [pin(color), pin(depth)]
    for _ in range(2):
        on_device = uploader.upload([pinned])
        many = frames(given.calibration, *on_device, plane=plane)
        assert_equal(detect(many, config), want)
