"""HTML report: it agrees with the tables, needs no network, and runs no text of a log."""

import json
import re
import shutil
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxdet.config import Config, GroundConfig
from jaxdet.errors import FrameStatus, InputError, printable
from jaxdet.export import export
from jaxdet.export.html.choice import choose
from jaxdet.export.html.collect import HISTOGRAM_BINS, MOST_BINS, Columns, LogFigures, Timeline
from jaxdet.export.html.page import REASONS
from jaxdet.export.recordings import find
from jaxdet.results.reading import Results, open_results
from tests.made_results import START_NS, STEP_NS, make_results

HOSTILE = "</script><img src=x onerror=boom()>\u2028<!--"


def page_of(folder: Path, output: Path, logs: tuple[str, ...] = ()) -> dict[str, Any]:
    """Export results; return the data that the script of the page draws."""
    with Results(folder) as results:
        export(results, "html", output, find(results, logs))
    text = output.read_text("utf-8")
    match = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert match
    return json.loads(match[1])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    config = Config(ground=GroundConfig(max_depth_m=5.0))
    return make_results(folder / "out", {HOSTILE: 3000, "b": 400, "short": 1}, config)


def test_figures_equal_those_of_the_tables(made: Path, tmp_path: Path) -> None:
    data = page_of(made, tmp_path / "page.html")
    frames = open_results(made).tables().frames.to_pandas()
    obstacles = open_results(made).tables().obstacles.to_pandas()
    assert [log["log"] for log in data["logs"]] == [printable(HOSTILE), "b", "short", "torn"]
    for log in data["logs"][:3]:
        rows = frames[frames.log == log["log"]]
        near = obstacles[obstacles.log == log["log"]].groupby("frame").distance_m.min()
        assert log["frames"] == len(rows) and log["obstacles"] == rows.num_obstacles.sum()
        assert log["status"] == rows.status.value_counts().to_dict()
        bins, number = log["bins"], np.arange(len(rows)) // log["stride"]
        each = rows.set_index("frame").assign(near=near).groupby(number).near.min()
        shown = [np.nan if value is None else value for value in bins["nearest"]]
        np.testing.assert_allclose(shown, each.round(3), atol=1e-3)
        assert sum(bins["lost"]) == (rows.status != "ok").sum()
        assert bins["most"] == rows.num_obstacles.groupby(number).max().tolist()
        assert sum(log["per_frame"]) == len(near)
        assert sum(log["per_obstacle"]) == rows.num_obstacles.sum()
        every = obstacles[obstacles.log == log["log"]].distance_m
        for at, limit in enumerate(data["near"]):
            assert log["near_frames"][at] == (near < limit).sum()
            assert log["near_obstacles"][at] == (every < limit).sum()
        if len(near):
            assert log["nearest"] == [pytest.approx(near.min(), abs=1e-3), near.idxmin()]
    assert data["logs"][3]["error"] and not data["logs"][3]["bins"]
    assert data["near"] == [1.0, 0.5]
    farthest = max(distance or 0 for log in data["logs"][:3] for distance in log["bins"]["nearest"])
    assert 5 < farthest <= data["reach"] == 6  # beyond the depth range, to the side
    assert data["settings"] == [["ground.max_depth_m", "5.0", "4.0"]]


@pytest.mark.parametrize("max_depth_m", [2.0, 3.0, 6.0, 8.0])
def test_near_obstacles_are_counted_whatever_the_bins(max_depth_m: float) -> None:
    """With a range of 3 or 6 m, 1 m is in the middle of a bin; with 8 m, 0.5 m is."""
    distance = np.array([0.2, 0.49, 0.5, 0.95, 0.999, 1.0, 1.7], np.float32)
    n = len(distance)
    names, flags = np.full(n, "ok", object), np.zeros(n, bool)
    rows = Columns(np.arange(n), np.arange(n), names, flags, np.ones(n, np.int64), distance)
    figures = LogFigures("a", max_depth_m / (HISTOGRAM_BINS - 1), Timeline(n))
    figures.add(rows)
    assert figures.near_frames.tolist() == figures.near_obstacles.tolist() == [5, 2]


def test_a_frame_with_many_obstacles_lists_the_nearest(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("jaxdet.export.html.MOST_ROWS", 2)
    data = page_of(made, tmp_path / "page.html")
    obstacles = open_results(made).tables().obstacles.to_pandas()
    full = [frame for frame in data["frames"] if frame["count"] > 2]
    assert full
    for frame in full:
        log = data["logs"][frame["log"]]["log"]
        rows = obstacles[(obstacles.log == log) & (obstacles.frame == frame["frame"])]
        nearest = rows.nsmallest(2, "distance_m").sort_values("obstacle")
        assert [one[0] for one in frame["rows"]] == nearest.obstacle.tolist()
        assert min(one[1] for one in frame["rows"]) == frame["nearest"]


def test_gallery_shows_the_nearest_the_fullest_and_the_failed_frames(
    made: Path, tmp_path: Path
) -> None:
    data = page_of(made, tmp_path / "page.html")
    frames = open_results(made).tables().frames.to_pandas()
    obstacles = open_results(made).tables().obstacles.to_pandas()
    names = [log["log"] for log in data["logs"]]
    kinds = {kind for frame in data["frames"] for kind in frame["kinds"]}
    assert kinds == {"nearest", "most", "overflow", "lost"}
    for frame in data["frames"]:
        log, number = names[frame["log"]], frame["frame"]
        (row,) = frames[(frames.log == log) & (frames.frame == number)].itertuples()
        rows = obstacles[(obstacles.log == log) & (obstacles.frame == number)]
        assert (frame["status"], frame["count"]) == (row.status, row.num_obstacles)
        assert frame["stamp"] == str(START_NS + frame["frame"] * STEP_NS) == str(row.stamp_ns)
        assert [one[0] for one in frame["rows"]] == rows.obstacle.tolist()
        outlines = [pytest.approx(corners, abs=0.006) for corners in rows.corners_ground]
        assert frame["outlines"] == outlines
        assert frame["nearest"] == (
            None if rows.empty else pytest.approx(rows.distance_m.min(), abs=1e-3)
        )
        assert ("lost" in frame["kinds"]) == (row.status != "ok")
    reasons = [f["reason"] for f in data["frames"] if f["frame"] == 7 and f["status"] != "ok"]
    assert all("isn't what it was" in reason for reason in reasons)


def test_three_frames_are_marked_as_nearest_and_three_as_fullest(tmp_path: Path) -> None:
    folder = make_results(tmp_path / "out", {"a": 39})
    data = page_of(folder, tmp_path / "page.html")
    obstacles = open_results(folder).tables().obstacles.to_pandas()
    counts = obstacles.groupby("frame").size()
    marked = {
        kind: {frame["frame"] for frame in data["frames"] if kind in frame["kinds"]}
        for kind in ("nearest", "most")
    }
    assert marked["nearest"] == set(obstacles.groupby("frame").distance_m.min().nsmallest(3).index)
    assert len(marked["most"]) == 3 and counts[list(marked["most"])].min() == counts.max()
    assert sum("sample" in frame["kinds"] for frame in data["frames"]) > 8


def test_frames_with_equally_many_obstacles_are_not_marked_as_fullest() -> None:
    figures = LogFigures("a", 0.1, Timeline(30))
    each, names = np.ones(30, np.int64), np.full(30, "ok", object)
    rows = Columns(np.arange(30), np.arange(30), names, each == 0, each, np.ones(30, np.float32))
    figures.add(rows)
    kinds = [kind for kinds in choose([figures], []).values() for kind in kinds]
    assert kinds.count("nearest") == 3 and "most" not in kinds


def test_each_status_is_explained() -> None:
    assert {str(status) for status in FrameStatus} <= {"ok", *REASONS}


def test_timeline_does_not_depend_on_the_chunks() -> None:
    rng = np.random.default_rng(3)
    n = 5 * MOST_BINS + 17
    count = rng.integers(0, 4, n)
    status = np.where(rng.random(n) < 0.1, "no_color", "ok").astype(object)
    stamps, distance = np.arange(n) * 10, rng.random(count.sum()).astype(np.float32)
    rows = Columns(np.arange(n), stamps, status, np.zeros(n, bool), count, distance)
    whole = Timeline(n)
    whole.add(rows)
    assert MOST_BINS // 2 < whole.bins <= MOST_BINS
    for size in (1, 100, MOST_BINS):
        parts, first = Timeline(n), np.append(0, np.cumsum(count))
        for start in range(0, n, size):
            some = slice(start, min(n, start + size))
            own = slice(first[some.start], first[some.stop])
            parts.add(Columns(*(part[some] for part in rows[:-1]), distance[own]))
        for name, values in vars(whole).items():
            np.testing.assert_array_equal(getattr(parts, name), values, name)


def test_failed_logs_are_skipped(made: Path, tmp_path: Path) -> None:
    for name in ("b", "torn"):
        (tmp_path / f"{name}.mcap").touch()
    with Results(made) as results:
        assert list(find(results, [str(tmp_path)])) == ["b"]


def test_texts_of_a_log_are_escaped(made: Path, tmp_path: Path) -> None:
    page_of(made, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text("utf-8")
    assert "onerror" in text and "<img src=x" not in text and text.count("</script>") == 2
    assert "\u2028" not in text and "http" not in text.replace("http-equiv", "").replace(
        "http://www.w3.org/2000/svg", ""
    )


def test_page_size_is_bounded(tmp_path: Path) -> None:
    folder = make_results(tmp_path / "out", {f"log {i}": 20_000 for i in range(5)})
    page_of(folder, tmp_path / "page.html")
    assert (tmp_path / "page.html").stat().st_size < 500_000


@pytest.mark.parametrize("content", [b"", b"no picture"])
def test_a_damaged_picture_is_named(
    drive: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], content: bytes
) -> None:
    folder = shutil.copytree(drive, tmp_path / "drive") / "out"
    picture = next((folder / "pictures").iterdir())
    picture.write_bytes(content)
    with pytest.raises(InputError, match=f"{picture.name}: the picture is damaged; remove it"):
        page_of(folder, tmp_path / "page.html")
    assert not capfd.readouterr().err  # no messages of OpenCV


def test_pictures_are_drawn_from_the_log(drive: Path, tmp_path: Path) -> None:
    drawn = page_of(drive / "out", tmp_path / "page.html")  # the log has not moved
    assert len(drawn["frames"]) == 5 and not drawn["undrawn"]
    assert all(f["picture"] and f["size"][0] <= 1024 for f in drawn["frames"])
    moved = tmp_path / "moved"
    shutil.copytree(drive / "out", moved)
    summary = (moved / "summary.json").read_text("utf-8")
    (moved / "summary.json").write_text(summary.replace(str(drive), "/gone"), "utf-8")
    without = page_of(moved, tmp_path / "without.html")
    assert sum(f["picture"] is not None for f in without["frames"]) == 2
    assert without["logs"][0]["floor"] == "its own depth (5)"
    (line,) = without["undrawn"]
    assert line.startswith("/gone/drive.mcap: the log is not at its original path")
    assert line.endswith("pass it with --log")
    assert without["logs"][0]["map"]["picture"].startswith("data:image/webp;base64,")
    given = page_of(moved, tmp_path / "given.html", (str(drive / "drive.mcap"),))
    assert given["frames"] == drawn["frames"]


def test_a_missing_map_is_named(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (log,) = page_of(drive / "out", tmp_path / "page.html")["logs"]
    assert log["map"] and log["map_file"] == "out/map"
    monkeypatch.setattr("jaxdet.export.html.MOST_MAPS", 0)
    (log,) = page_of(drive / "out", tmp_path / "without.html")["logs"]
    assert log["map"] is None and log["map_file"] == "out/map"


def test_page_of_a_recorded_log_agrees_with_its_tables(
    aims_log: Path, aims_results: Path, tmp_path: Path
) -> None:
    log, folder = aims_log, aims_results
    data = page_of(folder, tmp_path / "page.html", (str(log),))
    assert all(frame["picture"] for frame in data["frames"]) and data["logs"][0]["map"] is None
    assert (tmp_path / "page.html").stat().st_size < 2_500_000


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api")
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if not program:
        pytest.skip("no browser here")
    with sync_api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield found
        found.close()


class Opened:
    """Page in a browser without a network."""

    def __init__(self, browser: Any, path: Path, **how: Any) -> None:
        context = browser.new_context(offline=True, **how)
        self.page, self.requests, self.errors = context.new_page(), [], []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("console", lambda message: self.errors.append(message.text))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(path.as_uri())
        self.path = path

    def check(self) -> None:
        """Assert that only the page was requested, without errors."""
        requests = [url for url in self.requests if not url.startswith("data:")]
        assert requests == [self.path.as_uri()] and self.errors == []
        assert self.page.evaluate("typeof boom") == "undefined"


def test_browser_shows_lost_frames(made: Path, tmp_path: Path, browser: Any) -> None:
    data = page_of(made, tmp_path / "page.html")
    opened = Opened(browser, tmp_path / "page.html", viewport={"width": 1280, "height": 900})
    page = opened.page
    assert page.title() == "Obstacles in 4 logs"
    assert page.locator("#figures dd").nth(1).inner_text().startswith("3,401")
    assert "no colour image near enough" in page.locator("#lost").inner_text()
    assert "torn: no <b>images</b> in it" in page.locator("#lost").inner_text()
    assert page.locator(".timeline").count() == 3
    assert page.locator("#only option").all_inner_texts()[1].startswith("</script><img")

    def cards() -> int:
        return page.locator(".card").count()

    assert cards() == len(data["frames"])
    found = [frame for frame in data["frames"] if frame["status"] == "ok"]
    assert page.locator(".card .plan").count() == len(found)  # outlines replace missing pictures
    outlines = sum(len(frame["rows"]) for frame in found)
    assert page.locator(".card .plan polygon").count() == outlines > len(found)
    shown = page.locator("#shown").inner_text()
    assert re.search(
        r"; no pictures of some frames: /nowhere/.*with --log, and 1 further log$", shown
    )
    for kind, name in (("lost", "Without a result"), ("overflow", "Overflow")):
        page.get_by_role("radio", name=name).click()
        assert cards() == sum(kind in frame["kinds"] for frame in data["frames"]) > 0
    page.get_by_role("radio", name="Nearest", exact=True).click()
    page.locator("#order").select_option("nearest")
    texts = page.locator(".card").all_inner_texts()
    metres = [float(re.search(r"nearest ([\d.]+) m", text)[1]) for text in texts]
    assert metres == sorted(metres) and len(metres) == 12
    page.keyboard.press("Tab")
    page.get_by_role("radio", name="Nearest", exact=True).focus()
    page.keyboard.press("ArrowLeft")
    assert page.get_by_role("radio", name="All", exact=True).get_attribute("aria-checked") == "true"
    page.locator("#only").select_option("1")
    assert cards() == sum(frame["log"] == 1 for frame in data["frames"])
    page.set_viewport_size({"width": 360, "height": 740})
    lost = page.locator("#lost td:first-child").all()
    assert lost and all(cell.bounding_box()["width"] > 60 for cell in lost)  # whole words
    assert page.locator("#figures dd").nth(1).inner_text().startswith("400")
    opened.check()


def test_browser_opens_frames(drive: Path, tmp_path: Path, browser: Any) -> None:
    data = page_of(drive / "out", tmp_path / "page.html")
    opened = Opened(browser, tmp_path / "page.html", viewport={"width": 1280, "height": 900})
    page, dialog = opened.page, opened.page.locator("dialog")
    line = page.locator(".timeline svg")
    line.hover()
    tip = page.locator("#tip").inner_text()
    assert re.match(r"frame \d · .* m · \d+ obstacles? · picture", tip)
    line.click()
    assert dialog.is_visible() and dialog.locator("img").evaluate("i => i.naturalWidth") == 1024
    first = page.locator("#frame-title").inner_text()
    page.keyboard.press("ArrowRight")
    assert page.locator("#frame-title").inner_text() != first
    page.keyboard.press("Escape")
    assert not dialog.is_visible()
    assert line.evaluate("node => node === document.activeElement")
    page.wait_for_timeout(100)  # the line must not move under a resting pointer
    assert not page.locator("#tip").is_visible()
    page.keyboard.press("End")
    page.keyboard.press("Enter")
    assert page.locator("#frame-title").inner_text() == "drive · frame 4"
    shown = f"{data['frames'][-1]['rows'][0][1]:.2f} m"
    assert dialog.locator("tbody tr").first.inner_text().split("\t")[:2] == ["0", shown]
    color = "node => getComputedStyle(node).backgroundColor"
    assert dialog.locator("tbody .key").first.evaluate(color) == "rgb(255, 92, 92)"
    assert "floor from\nits own depth" in dialog.inner_text()
    rows = dialog.locator("tbody tr").count()
    assert f"obstacles\n{rows}" in dialog.inner_text()
    page.get_by_role("button", name="Close").click()
    page.get_by_role("radio", name="All obstacles").click()
    assert "distance of each obstacle" in page.locator("#histogram").inner_html()
    assert page.locator("#map image").count() == 1 and page.locator("#map svg .path").count() == 2
    unnamed = "[...document.querySelectorAll('button,select,svg')].filter(e => "
    unnamed += "!e.textContent.trim() && !e.getAttribute('aria-label')).length"
    assert page.evaluate(unnamed) == 0 and page.locator("img:not([alt])").count() == 0
    opened.check()


def test_browser_shows_round_numbers_on_axes(drive: Path, tmp_path: Path, browser: Any) -> None:
    data = page_of(drive / "out", tmp_path / "page.html")
    opened = Opened(browser, tmp_path / "page.html", viewport={"width": 1280, "height": 900})
    line = opened.page.locator(".timeline svg")
    texts = line.locator("text").all_text_contents()
    times = [float(text.removesuffix(" s")) for text in texts if text.endswith(" s")]
    steps = {round(after - before, 6) for before, after in pairwise(times)}
    assert len(steps) == 1 and steps < {0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0} and times[0] == 0
    far = [float(text.removesuffix(" m")) for text in texts if text.endswith(" m")]
    nearest = max(frame["nearest"] for frame in data["frames"])
    assert nearest <= far[-1] < nearest + 1
    opened.check()


def test_browser_shows_narrow_dark_and_printed_pages(
    drive: Path, tmp_path: Path, browser: Any
) -> None:
    page_of(drive / "out", tmp_path / "page.html")
    grounds = set()
    for scheme in ("light", "dark"):
        how = {"viewport": {"width": 360, "height": 740}, "color_scheme": scheme}
        opened = Opened(browser, tmp_path / "page.html", **how)
        page = opened.page
        assert page.evaluate("document.documentElement.scrollWidth") <= 360
        name = page.locator("#logs tbody td").first  # lines do not break inside of words
        assert name.inner_text() == "drive" and name.bounding_box()["width"] > 36
        grounds.add(page.evaluate("getComputedStyle(document.body).backgroundColor"))
        page.emulate_media(media="print")
        assert not page.locator("#kinds").is_visible() and page.locator(".card").first.is_visible()
        assert len(page.pdf()) > 10_000
        opened.check()
    assert len(grounds) == 2


def test_browser_enlarges_pictures_on_a_phone(
    driven_results: Path, tmp_path: Path, browser: Any
) -> None:
    page_of(driven_results, tmp_path / "page.html")
    how = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
    opened = Opened(browser, tmp_path / "page.html", **how)
    page = opened.page
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    size = "t => parseFloat(getComputedStyle(t).fontSize) * t.getScreenCTM().a"
    sizes = page.locator("svg text").evaluate_all(f"texts => texts.map({size})")
    assert len(sizes) > 15 and min(sizes) > 10.99
    page.locator(".card").first.tap()
    picture, frame = page.locator(".zoom img"), page.locator(".zoom")
    small = picture.bounding_box()["width"]
    assert 300 < small < 390
    page.locator(".zoom button").tap(position={"x": small - 20, "y": 30})
    assert picture.bounding_box()["width"] == 1024  # full size, with readable labels
    shown = frame.evaluate("n => [n.clientWidth, n.scrollLeft]")
    assert shown[0] < 390 and shown[1] > 512  # scrolled to the tapped position
    page.locator(".zoom button").tap()
    assert picture.bounding_box()["width"] == small
    fits = "tables => tables.map(t => t.scrollWidth - t.clientWidth)"
    assert page.locator(".wide").evaluate_all(fits) == [0, 0, 0]
    head = "n => getComputedStyle(n, '::before').content"
    heads = page.locator("dialog tr").last.locator("td").evaluate_all(f"tds => tds.map({head})")
    assert heads[0] == '"obstacle"' and heads[-1] == '"cells"'
    opened.check()


def test_browser_does_not_upscale_pictures(
    driven_results: Path, tmp_path: Path, browser: Any
) -> None:
    page_of(driven_results, tmp_path / "page.html")
    opened = Opened(browser, tmp_path / "page.html", viewport={"width": 1440, "height": 900})
    opened.page.locator(".card").first.click()
    assert opened.page.locator(".zoom img").bounding_box()["width"] <= 1024
    opened.check()


def test_browser_shows_outlines_in_place_of_missing_pictures(
    made: Path, tmp_path: Path, browser: Any
) -> None:
    page_of(made, tmp_path / "page.html")
    opened = Opened(browser, tmp_path / "page.html", viewport={"width": 390, "height": 844})
    size = "t => parseFloat(getComputedStyle(t).fontSize) * t.getScreenCTM().a"
    sizes = opened.page.locator(".plan text").evaluate_all(f"texts => texts.map({size})")
    assert sizes and min(sizes) > 10.99
    opened.check()
