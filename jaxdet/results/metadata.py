"""Metadata of the result tables: format, version, configuration and inputs.

The metadata is text in key-value pairs of the Parquet files. It doesn't depend on the time, the
machine, the device, the batch or the paths of files, so that the files' bytes don't either.
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
"""Number of the tables' format; it changes with the columns or their meaning."""

FORMAT_KEY, VERSION_KEY = "jaxdet.format", "jaxdet.version"
CONFIG_KEY, INPUTS_KEY = "jaxdet.config", "jaxdet.inputs"

_KEYS = ("log", "camera")
_CHANGES_NO_ROW = ("preset", "backend", "batch_size")
"""Keys of ``config.json`` that change no row of the tables."""


class Inputs:
    """Digests for each camera of each log in a table: of its stamps and its calibration."""

    def __init__(self) -> None:
        self._frames: dict[tuple[str, str], int] = {}
        self._digests: dict[tuple[str, str], Any] = {}

    def add(self, frames: pa.Table) -> None:
        """Add rows of ``frames.parquet``, in order."""
        # As lists: Arrow's groups and arrays for NumPy import pandas.
        columns = [frames[name].to_pylist() for name in (*_KEYS, "stamp_ns")]
        for name, same in groupby(zip(*columns, strict=True), key=lambda row: row[:2]):
            rows = [at for *_, at in same]
            self._frames[name] = self._frames.get(name, 0) + len(rows)
            digest = self._digests.setdefault(name, hashlib.sha256())
            digest.update(np.array(rows, "<i8").tobytes())

    def fingerprints(self, summary: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Return each log and camera with its number of frames and its digest.

        Args:
            summary: Content of ``summary.json``, of which only the calibrations are used.
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
    """Return the key-value metadata of both tables.

    Args:
        config: Content of ``config.json``, of which only values that can change a row are used.
        summary: Content of ``summary.json``, of which only the logs' calibrations are used.
        inputs: Inputs of the rows.
    """
    method = {key: value for key, value in config.items() if key not in _CHANGES_NO_ROW}
    if isinstance(log := method.get("log"), Mapping):  # scanning a log changes none of its frames
        method["log"] = {key: value for key, value in log.items() if key != "scan"}
    return {
        FORMAT_KEY: str(FORMAT),
        VERSION_KEY: jaxdet.__version__,
        CONFIG_KEY: _canonical(method),
        INPUTS_KEY: _canonical(inputs.fingerprints(summary)),
    }


def _canonical(value: Any) -> str:
    """Return a value as JSON in its one canonical form."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, default=str)
