"""Tracks of logs, as the page lists them and draws their ways on the map."""

import heapq
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from jaxdet.results.reading import ResultLog, Results

MOST = 200
"""Tracks of a log that are listed, of those that move and of those that stand."""
MOST_POINTS = 40
"""Of a way."""


def track_rows(results: "Results", log: "ResultLog", begin_ns: int) -> dict[str, Any] | None:
    """The tracks of a log that were seen in most frames, those that move and those that stand.

    Args:
        results: What a run wrote.
        log: One of its logs.
        begin_ns: The stamp that times are counted from.

    Returns:
        ``moving`` and ``standing``, how many there are, and ``rows`` of number, whether it moves,
        begin and length of sight [s], mean and greatest speed [m/s], length and width [m], and the
        way in the world, x and y in turn [m], null where there are no poses. None without tracks.
    """
    if not results.tracked:
        return None
    most: dict[bool, list[tuple[int, int, dict[str, Any]]]] = {True: [], False: []}
    count = {True: 0, False: 0}
    for track in results.tracks(log):
        heap = most[track["moving"]]
        count[track["moving"]] += 1
        heapq.heappush(heap, (track["num_frames"], -track["track"], track))
        if len(heap) > MOST:
            heapq.heappop(heap)
    kept = sorted((t for heap in most.values() for _, _, t in heap), key=lambda t: t["track"])
    rows = [_row(track, begin_ns) for track in kept]
    return {"moving": count[True], "standing": count[False], "rows": rows}


def _row(track: dict[str, Any], begin_ns: int) -> list[Any]:
    path = np.reshape(track["path"], (-1, 2))
    path = path[np.linspace(0, len(path) - 1, min(len(path), MOST_POINTS)).round().astype(int)]
    begin, end = ((track[f"{at}_stamp_ns"] - begin_ns) / 1e9 for at in ("first", "last"))
    metres = (track[name] for name in ("mean_speed_mps", "max_speed_mps", "length_m", "width_m"))
    rounded = [round(value, 2) for value in (begin, end - begin, *metres)]
    way = np.round(path, 2).ravel().tolist() if track["in_world"] else None
    return [track["track"], track["moving"], *rounded, way]
