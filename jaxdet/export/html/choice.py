"""Selection of the frames of the gallery."""

from collections.abc import Iterable, Sequence
from itertools import chain, zip_longest

from jaxdet.export.html.collect import LogFigures

EACH = 12
"""Maximum number of chosen frames of each of the kinds nearest, most obstacles, and overflow."""
RARE = 10
"""At most one in ``RARE`` frames is marked as nearest, and at most one as most obstacles."""
LOST = 36
"""Maximum number of chosen frames without a result."""
SAMPLED = 36
"""Maximum number of further chosen frames, which have a picture."""

Key = tuple[str, int]
"""Log and frame number."""


def choose(figures: Sequence[LogFigures], pictures: Iterable[Key]) -> dict[Key, list[str]]:
    """Choose frames for the gallery.

    At most a tenth of the frames are marked as nearest, and at most a tenth as most obstacles; the
    latter have more obstacles than the mean of their log.

    Args:
        figures: Statistics of each log.
        pictures: Frames with a picture.

    Returns:
        Kinds of each chosen frame, in the order of the tables.
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
    mean = {f.log: f.per_obstacle.sum() / max(1, f.timeline.count) for f in figures}
    rare = max(1, sum(f.timeline.count for f in figures) // RARE)
    nearest = [(log, n) for _, log, n in sorted(near)][:EACH]
    fullest = [(log, n) for _, log, n in sorted(full)][:EACH]
    fuller = [(log, n) for count, log, n in sorted(full) if -count > mean[log]]
    add("nearest", nearest, rare)
    add("most", fuller[:EACH], rare)
    add("overflow", _in_turn([[(f.log, n) for n in f.overflow] for f in figures]), EACH)
    add("lost", _in_turn([[(f.log, n) for n in f.lost] for f in figures]), LOST)
    add("sample", (key for key in (*nearest, *fullest) if key not in kinds), 2 * EACH)
    others = [key for key in pictures if key not in kinds]
    step = -(-len(others) // SAMPLED) or 1
    add("sample", others[::step], SAMPLED)
    place = {f.log: number for number, f in enumerate(figures)}
    return dict(sorted(kinds.items(), key=lambda item: (place[item[0][0]], item[0][1])))


def _in_turn(lists: Iterable[Sequence[Key]]) -> Iterable[Key]:
    """Yield the first element of each list, then the second of each, and so on."""
    return (key for key in chain(*zip_longest(*lists)) if key is not None)
