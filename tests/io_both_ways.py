"""Comparison of logs opened by their index with scanned ones, in any order of reading."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from jaxdet.errors import RescanError
from jaxdet.io import Batch, Log, LogDescription, LogFiles, LogOptions, open_log
from jaxdet.io.timeline import Notes, total

_ARRAYS = ("color", "depth", "number", "stamp_ns", "color_stamp_ns", "valid", "T_world_camera")


def assert_same_batch(found: Batch, expected: Batch) -> None:
    """Assert that batches are equal except for their notes."""
    assert (found.status, found.errors) == (expected.status, expected.errors)
    for name in ("log_time_ns", "nearest_color_ns"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert found.notes.bad_color == expected.notes.bad_color
    for name in _ARRAYS:
        one, other = getattr(found.frames, name), getattr(expected.frames, name)
        assert (one is None) == (other is None), name
        if one is not None:
            assert one.dtype == other.dtype
            np.testing.assert_array_equal(one, other, name)


def assert_same_log(found: Log, scanned: Log, sizes: Sequence[int] = (3, 64)) -> None:
    """Assert that logs are equal, with batches of several sizes.

    Raises:
        RescanError: ``found`` cannot be read by its index.
    """
    assert found.num_frames == scanned.num_frames
    assert found.calibration == scanned.calibration and found.base_frame == scanned.base_frame
    for size in sizes:
        color = size != 3
        pairs = zip(
            found.batches(size, color=color), scanned.batches(size, color=color), strict=True
        )
        notes = []
        for one, other in pairs:
            assert_same_batch(one, other)
            notes.append(one.notes)
        descriptions = [found.described(total(notes)), scanned.described(Notes())]
        if not total(notes).bad_color:
            _assert_same_description(*descriptions)
    order = np.random.default_rng(0).integers(0, max(found.num_frames, 1), 5).tolist()
    if found.num_frames:
        assert_same_batch(found.read(order), scanned.read(order))
        one, other = (log.read(order, color=True, need_color=True) for log in (found, scanned))
        assert_same_batch(one, other)
    np.testing.assert_array_equal(found.stamps_ns, scanned.stamps_ns)
    np.testing.assert_array_equal(found.color_stamps_ns, scanned.color_stamps_ns)
    assert (found.has_color, found.has_color_camera, found.color_problem, found.color_frame) == (
        *(scanned.has_color, scanned.has_color_camera, scanned.color_problem, scanned.color_frame),
    )
    one, other = found.T_world_camera, scanned.T_world_camera
    assert (one is None) == (other is None)
    np.testing.assert_array_equal(one if one is not None else 0, other if other is not None else 0)
    np.testing.assert_array_equal(
        found.T_base_camera if found.T_base_camera is not None else 0,
        scanned.T_base_camera if scanned.T_base_camera is not None else 0,
    )


def _assert_same_description(found: LogDescription, expected: LogDescription) -> None:
    for name in expected._fields:
        one, other = getattr(found, name), getattr(expected, name)
        if name == "warnings":
            one, other = sorted(one), sorted(other)
        if name == "topics":
            one, other = ([item._replace(problem="") for item in items] for items in (one, other))
        assert name == "integrity" or str(one) == str(other), name


def is_indexed(log: Log) -> bool:
    """Return whether a log was opened by its index."""
    return log.description.integrity[0].by_index


def open_both_ways(source: str | LogFiles, options: LogOptions | None = None) -> Log:
    """Open a log; if it is opened by its index, compare it with a scan."""
    found = open_log(source, options)
    if is_indexed(found):
        with open_log(source, options) as again:
            if _can_be_read(again):
                with open_log(source, scanning(options)) as scanned:
                    assert_same_log(again, scanned)
    return found


def _can_be_read(log: Log) -> bool:
    """Return whether all frames of a log can be read by its index."""
    with suppress(RescanError):
        return sum(len(batch.status) for batch in log.batches(5)) == log.num_frames
    return False


def scanning(options: LogOptions | None = None) -> LogOptions:
    """Return the options with ``scan`` switched on."""
    return replace(options or LogOptions(), scan=True)
