"""Logs of the feed benchmark, and their decoding by its peers."""

from typing import NamedTuple

import numpy as np
import pytest

from benchmarks.feed import check
from benchmarks.feed_logs import CONFIG, FORMS, topics_of, write
from jaxdet.io import open_log


class Frame(NamedTuple):
    """Frame with those fields of a simulated frame that are written to a log."""

    color: np.ndarray
    depth: np.ndarray


def frames() -> list[Frame]:
    random = np.random.default_rng(2)
    rows = np.linspace(300, 9000, CONFIG.height)[:, None]
    found = []
    for _ in range(3):
        depth = rows + random.normal(0, 9, (CONFIG.height, CONFIG.width))
        depth[random.random(depth.shape) < 0.1] = 0
        smooth = np.cumsum(random.integers(-2, 3, (CONFIG.height, CONFIG.width, 3)), axis=1) + 128
        found.append(Frame(np.clip(smooth, 0, 255).astype(np.uint8), depth.astype(np.uint16)))
    return found


@pytest.mark.parametrize("name", FORMS)
def test_all_readers_return_equal_images_of_each_format(name, tmp_path):
    log, written, form = tmp_path / "log.mcap", frames(), FORMS[name]
    write(log, form, written, count=5)
    check(log, topics_of(form), 5)
    with open_log(str(log)) as opened:
        assert opened.num_frames == 5
        batch = opened.read(range(5), color=True).frames
    for number in range(5):
        np.testing.assert_array_equal(batch.depth[number], written[number % 3].depth)
        if form.color != "jpeg":
            np.testing.assert_array_equal(batch.color[number], written[number % 3].color)
