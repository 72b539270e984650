"""Settings and fixtures for all tests."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]

# Set before JAX and Warp are imported; commands that tests start inherit the variables.
os.environ["XLA_FLAGS"] = " ".join(
    [os.environ.get("XLA_FLAGS", ""), "--xla_force_host_platform_device_count=2"]
).strip()
os.environ["JAX_NUMPY_DTYPE_PROMOTION"] = "strict"
os.environ["JAX_NUMPY_RANK_PROMOTION"] = "raise"
os.environ.setdefault("WARP_CACHE_PATH", str(ROOT / ".cache" / "warp"))
os.environ.setdefault("JAXDET_CACHE", str(ROOT / ".cache" / "jaxdet"))
os.environ.setdefault("HYPOTHESIS_STORAGE_DIRECTORY", str(ROOT / ".cache" / "hypothesis"))

import hypothesis  # noqa: E402  (Hypothesis reads its folder on import)

hypothesis.settings.register_profile(
    "jaxdet", derandomize=True, database=None, deadline=None, max_examples=50
)
hypothesis.settings.load_profile("jaxdet")


@pytest.fixture(scope="session", autouse=True)
def started() -> None:
    """Use the caches of compiled programs, and let Warp report only warnings and errors.

    JAX has two CPU devices, of which the first is the default, so that tests share programs;
    ``test_batches.py`` uses both.
    """
    import jax
    import warp

    from jaxdet.engine import use_caches

    use_caches()
    warp.config.log_level = warp.LOG_WARNING
    if jax.default_backend() == "cpu":
        jax.config.update("jax_default_device", jax.devices()[0])


def present_devices() -> list:
    """Return the kinds of device that JAX finds, as parameters; CUDA is marked ``gpu``."""
    import jax

    try:
        jax.devices("cuda")
    except RuntimeError:
        return ["cpu"]
    return ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "device" in metafunc.fixturenames:
        metafunc.parametrize("device", present_devices(), indirect=True)


@pytest.fixture
def device(request: pytest.FixtureRequest) -> Iterator[Any]:
    """Device of each kind that is present, as the default of JAX during the test."""
    import jax

    chosen = jax.devices(request.param)[0]
    with jax.default_device(chosen):
        yield chosen


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of recorded logs next to the repository; skip if it is missing."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("no folder shared/data next to the repository")
    return folder


def _results_of(log: Path, folder: Path, pictures: int) -> Path:
    """Run a log with the command's defaults and ``pictures`` pictures; return the results."""
    from tests.runs import run_log

    run_log(log, folder, pictures=pictures, preset="wheeled")
    return folder


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a simulated log, ``drive.mcap``, and its results with two pictures, ``out``."""
    from jaxdet.sim import SimConfig, write_log

    folder = tmp_path_factory.mktemp("drive")
    write_log(folder / "drive.mcap", SimConfig(frames=5, width=320, height=240))
    _results_of(folder / "drive.mcap", folder / "out", 2)
    return folder


@pytest.fixture(autouse=True)
def both_ways(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """In tests of ``jaxdet.io``, compare each log opened by its index with a scan."""
    if hasattr(request.module, "open_log") and request.path.name.startswith("test_io"):
        from tests.io_both_ways import open_both_ways

        monkeypatch.setattr(request.module, "open_log", open_both_ways)


@pytest.fixture(scope="session")
def aims_log(shared_data: Path) -> Path:
    """Recorded log of a hand-held camera, without poses and transforms."""
    return shared_data / "aims_slam" / "aims_slam_18frames.mcap"


@pytest.fixture(scope="session")
def aims_results(aims_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of :func:`aims_log` with two pictures."""
    return _results_of(aims_log, tmp_path_factory.mktemp("aims") / "results", 2)


@pytest.fixture(scope="session")
def driven_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Small simulated log, ``sim.mcap``, of a driving robot."""
    from tests.export_results import sim_log

    return sim_log(tmp_path_factory.mktemp("driven") / "sim.mcap")


@pytest.fixture(scope="session")
def driven_results(driven_log: Path) -> Path:
    """Results of :func:`driven_log`."""
    from tests.export_results import run

    return run(driven_log, driven_log.parent / "results")
