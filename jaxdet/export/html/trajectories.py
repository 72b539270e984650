"""Tracks of logs, for the lists and maps of the page."""

import heapq
from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from jaxdet.results.reading import ResultLog, Results

MOST = 200
"""Maximum number of moving tracks, and of stationary tracks, listed per log."""
MOST_POINTS = 40
"""Maximum number of points of a trajectory."""


def track_rows(results: "Results", log: "ResultLog", begin_ns: int) -> dict[str, Any] | None:
    """Return the moving and the stationary tracks of a log with the most frames.

    Args:
        results: Results of a run.
        log: A log of the results.
        begin_ns: Timestamp to which times are relative [ns].

    Returns:
        None if the log has no tracks, else ``moving`` and ``standing``, the numbers of tracks;
        ``new``, the number of tracks that are not in the known map (None without a map); and
        ``rows``, one per listed track: number, whether it moves, begin and duration [s], mean and
        maximum speed [m/s], length and width [m], trajectory in the world with alternating x and y
        [m] (None without poses), persistence, fraction of frames that show floor at its place, and
        whether it is in the known map.
    """
    if not results.tracked(log):
        return None
    most: dict[bool, list[tuple[int, int, dict[str, Any]]]] = {True: [], False: []}
    count, in_map = {True: 0, False: 0}, Counter[bool | None]()
    for track in results.tracks(log):
        heap = most[track["moving"]]
        count[track["moving"]] += 1
        in_map[track["in_map"]] += 1
        heapq.heappush(heap, (track["num_frames"], -track["track"], track))
        if len(heap) > MOST:
            heapq.heappop(heap)
    kept = sorted((t for heap in most.values() for _, _, t in heap), key=lambda t: t["track"])
    rows = [_row(track, begin_ns) for track in kept]
    new = in_map[False] if in_map[False] + in_map[True] else None
    return {"moving": count[True], "standing": count[False], "new": new, "rows": rows}


def _row(track: dict[str, Any], begin_ns: int) -> list[Any]:
    path = np.reshape(track["path"], (-1, 2))
    path = path[np.linspace(0, len(path) - 1, min(len(path), MOST_POINTS)).round().astype(int)]
    begin, end = ((track[f"{at}_stamp_ns"] - begin_ns) / 1e9 for at in ("first", "last"))
    metres = (track[name] for name in ("mean_speed_mps", "max_speed_mps", "length_m", "width_m"))
    rounded = [round(value, 2) for value in (begin, end - begin, *metres)]
    trajectory = np.round(path, 2).ravel().tolist() if track["in_world"] else None
    shares = (track["persistence"], track["floor_seen"])
    places = [None if share is None else round(share, 2) for share in shares]
    return [track["track"], track["moving"], *rounded, trajectory, *places, track["in_map"]]
