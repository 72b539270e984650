"""Raw depth, depth in metres (32FC1) and aligned depth of a scene give the same obstacles."""

import pyarrow.parquet as pq
import pytest

from jaxdet.sim import SimConfig, write_log
from tests.runs import only_log, run_logs


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    folder = tmp_path_factory.mktemp("forms")
    found = {}
    for form in ("raw", "metres", "aligned"):
        log = folder / form / "sim.mcap"
        log.parent.mkdir()
        write_log(log, SimConfig(scene="row", frames=4, width=320, height=240, depth_form=form))
        summary = run_logs(log, folder / f"{form}_out", pictures=0)
        assert [log.error for log in summary.logs] == [None]
        names = ("frames", "obstacles")
        found[form] = [
            pq.read_table(only_log(folder / f"{form}_out") / f"{n}.parquet") for n in names
        ]
    return found


def test_depth_in_metres_gives_the_rows_of_depth_in_millimetres(tables):
    for raw, metres in zip(tables["raw"], tables["metres"], strict=True):
        assert raw.num_rows > 0
        assert raw.drop(["log"]).equals(metres.drop(["log"]))


def test_aligned_depth_finds_the_same_obstacles(tables):
    """The noise of aligned depth is drawn separately, so positions differ by that noise."""
    raw, aligned = (tables[form][1].to_pylist() for form in ("raw", "aligned"))
    assert abs(len(raw) - len(aligned)) <= 0.15 * len(raw)
    matched = 0
    for row in raw:
        near = [r for r in aligned if r["frame"] == row["frame"]]
        matched += any(
            abs(r["x"] - row["x"]) < 0.15 and abs(r["z"] - row["z"]) < 0.15 for r in near
        )
    assert matched >= 0.85 * len(raw)
