"""Which frames the gallery shows."""

from collections.abc import Iterable, Sequence
from itertools import chain, zip_longest

from jaxdet.export.html.collect import LogFigures

EACH = 12
"""Frames of each kind: nearest, most obstacles, more than there is room for."""
LOST = 36
"""Frames without a result."""
SAMPLED = 36
"""Frames with a picture for no other reason."""

Key = tuple[str, int]
"""A log and the number of one of its frames."""


def choose(figures: Sequence[LogFigures], pictures: Iterable[Key]) -> dict[Key, list[str]]:
    """Frames worth a look, each with the kinds that it is of, ordered as in the tables.

    Args:
        figures: Of each log.
        pictures: The frames that have one.
    """
    kinds: dict[Key, list[str]] = {}

    def add(kind: str, keys: Iterable[Key], most: int) -> None:
        for key, _ in zip(keys, range(most), strict=False):
            kinds.setdefault(key, []).append(kind)

    near = [
        (f.timeline.nearest_m[f.timeline.frame == n].min(), f.log, n)
        for f in figures
        for n in f.timeline.nearest_frames(EACH)
    ]
    full = [
        (-f.timeline.most[f.timeline.most_frame == n].max(), f.log, n)
        for f in figures
        for n in f.timeline.fullest_frames(EACH)
    ]
    add("nearest", ((log, n) for _, log, n in sorted(near)), EACH)
    add("most", ((log, n) for _, log, n in sorted(full)), EACH)
    add("overflow", _in_turn([[(f.log, n) for n in f.overflow] for f in figures]), EACH)
    add("lost", _in_turn([[(f.log, n) for n in f.lost] for f in figures]), LOST)
    others = [key for key in pictures if key not in kinds]
    step = -(-len(others) // SAMPLED) or 1
    add("sample", others[::step], SAMPLED)
    place = {f.log: number for number, f in enumerate(figures)}
    return dict(sorted(kinds.items(), key=lambda item: (place[item[0][0]], item[0][1])))


def _in_turn(lists: Iterable[Sequence[Key]]) -> Iterable[Key]:
    """The first of each list, then the second of each."""
    return (key for key in chain(*zip_longest(*lists)) if key is not None)
