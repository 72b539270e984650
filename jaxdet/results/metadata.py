"""What a result table says of itself: format, version, configuration and inputs.

It stands in the Parquet files' key-value metadata as text. Nothing of it depends on the time,
the machine, the device, the batch or where files lie, since the tables' bytes must not.
"""

import hashlib
import json
from collections.abc import Mapping
from itertools import groupby
from typing import Any

import numpy as np
import pyarrow as pa

import jaxdet

FORMAT = 5
"""Number of the tables' format; another one has other columns, or some of another meaning."""

FORMAT_KEY, VERSION_KEY = "jaxdet.format", "jaxdet.version"
CONFIG_KEY, INPUTS_KEY = "jaxdet.config", "jaxdet.inputs"

_KEYS = ("log", "camera")
_CHANGES_NO_ROW = ("preset", "backend", "batch_size")
"""Keys of ``config.json``."""


class Inputs:
    """What the rows are of: for each camera of each log a digest of its stamps and calibration."""

    def __init__(self) -> None:
        self._frames: dict[tuple[str, str], int] = {}
        self._digests: dict[tuple[str, str], Any] = {}

    def add(self, frames: pa.Table) -> None:
        """Takes in rows of ``frames.parquet``, in order."""
        # As lists: Arrow's groups and arrays for NumPy import pandas.
        columns = [frames[name].to_pylist() for name in (*_KEYS, "stamp_ns")]
        for name, same in groupby(zip(*columns, strict=True), key=lambda row: row[:2]):
            rows = [at for *_, at in same]
            self._frames[name] = self._frames.get(name, 0) + len(rows)
            digest = self._digests.setdefault(name, hashlib.sha256())
            digest.update(np.array(rows, "<i8").tobytes())

    def fingerprints(self, summary: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Each log and camera, its frames and the digest, which takes in the calibration.

        Args:
            summary: What ``summary.json`` holds; of it only the calibrations are used.
        """
        known = {(log["log"], log["camera"]): log["calibration"] for log in summary.get("logs", ())}
        found = []
        for (log, camera), digest in sorted(self._digests.items(), key=lambda item: item[0]):
            whole = digest.copy()
            whole.update(_canonical(known.get((log, camera))).encode())
            about = {"frames": self._frames[log, camera], "sha256": whole.hexdigest()}
            found.append({"log": log, "camera": camera, **about})
        return found


def table_metadata(
    config: Mapping[str, Any], summary: Mapping[str, Any], inputs: Inputs
) -> dict[str, str]:
    """The key-value metadata of both tables.

    Args:
        config: What ``config.json`` holds; of it only what can change a row is used.
        summary: What ``summary.json`` holds; of it only the logs' calibrations are used.
        inputs: What was read.
    """
    method = {key: value for key, value in config.items() if key not in _CHANGES_NO_ROW}
    if "log" in method:  # how a log is opened changes none of its frames
        method["log"] = {k: v for k, v in method["log"].items() if k != "scan"}
    return {
        FORMAT_KEY: str(FORMAT),
        VERSION_KEY: jaxdet.__version__,
        CONFIG_KEY: _canonical(method),
        INPUTS_KEY: _canonical(inputs.fingerprints(summary)),
    }


def _canonical(value: Any) -> str:
    """JSON of which there is one way to write it."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, default=str)
