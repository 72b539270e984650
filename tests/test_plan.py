"""UnitQueue: each unit is taken once, and adjacent units by the same worker."""

import random
from itertools import pairwise

import pytest

from jaxdet.engine.plan import Unit, UnitQueue, divide

UNITS = divide(range(1000), 8, 7)  # of 32 frames, at the end of 8


def taken(queue: UnitQueue, workers: list[int]) -> dict[int, list[Unit]]:
    """Return the units taken by workers in turns, until the queue is empty."""
    found: dict[int, list[Unit]] = {worker: [] for worker in workers}
    while queue:
        for worker in workers:
            if queue:
                found[worker].append(queue.take(worker))
    return found


@pytest.mark.parametrize("workers", [1, 2, 5, 50])
def test_each_unit_is_taken_once(workers):
    queue = UnitQueue(UNITS, workers)
    order = [random.Random(workers).randrange(workers) for _ in range(1000)]
    found = [queue.take(worker) for worker in order[: len(queue)]]
    assert sorted(found) == UNITS
    assert not queue


def test_one_worker_takes_units_in_order():
    assert taken(UnitQueue(UNITS, 1), [0])[0] == UNITS


def test_adjacent_units_go_to_the_same_worker():
    for units in taken(UnitQueue(UNITS, 3), [0, 1, 2]).values():
        apart = sum(a.stop != b.start for a, b in pairwise(units))
        assert len(units) > 10
        assert apart <= 3  # from large to small units, and to units of others


def test_large_units_are_taken_first():
    sizes = [unit.stop - unit.start for unit in taken(UnitQueue(UNITS, 3), [1])[1]]
    assert sizes == sorted(sizes, reverse=True)


def test_an_idle_worker_takes_the_later_half_of_the_units_of_another():
    queue = UnitQueue(UNITS[:8], 2)  # four adjacent units per worker
    assert [queue.take(0) for _ in range(4)] == UNITS[:4]
    assert queue.take(0) == UNITS[6]
    assert [queue.take(1) for _ in range(2)] == UNITS[4:6]


def test_units_put_back_are_taken_again():
    queue = UnitQueue(UNITS, 2)
    given = [queue.take(0), queue.take(1), queue.take(1)]
    queue.put_back(given[1:])
    assert sorted(unit for units in taken(queue, [0, 1]).values() for unit in units) == UNITS[1:]
