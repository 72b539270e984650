"""Detections of the default in harder families: walls, low objects, drops, ramps, depth errors."""

from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.paper.free import Claim, claim_of
from benchmarks.paper.lab import Lab
from benchmarks.paper.measure import measured
from benchmarks.paper.pictures import encode, grid, shot_picture, titled
from benchmarks.paper.section import Direction, Section, percent
from benchmarks.paper.shots import Spec, load_shots
from benchmarks.paper.systems import DEFAULT, Prepared, System, default, found_by, tally_of
from jaxdet.eval import Tally
from jaxdet.sim import HARD_FAMILIES

FAMILIES = (*HARD_FAMILIES, "mixed")
ERRORS = (0.0, 1.0)
"""Scale of the depth errors: none, and those of a D435."""
CAMERAS = {0.0: "clean", 1.0: "as a D435"}
HEIGHTS = ((0.15, 0.0), (0.6, 35.0), (0.8, 20.0), (1.3, 30.0))
"""Mounts other than 0.3 m and 10 degrees: height [m] and pitch [degree]."""
LEAST_FLOOR = 0.02
"""Minimum share of drivable floor in the image of a frame that counts as the worst."""
FIGURES: dict[str, Direction] = dict.fromkeys(
    ("accuracy", "recall", "precision", "coverage"), "higher"
)

COLUMNS = "ACC", "Recall", "Precision", "Coverage", "Floor claimed", "worst frame", "Missed / false"
"""Titles of the cells of :func:`_row`."""


class Judged(NamedTuple):
    """Result of a system on a frame."""

    tally: Tally
    claim: Claim
    pixels: int
    """Number of pixels of the image."""

    @property
    def mistakes(self) -> float:
        """Number of missed obstacles and false detections."""
        return self.tally.visible - self.tally.found + self.tally.false

    @property
    def claimed(self) -> float:
        """Share of the floor inside outlines; 0 if too little floor is visible."""
        return self.claim.share if self.claim.drivable >= LEAST_FLOOR * self.pixels else 0.0


Cells = dict[tuple[str, float], list[Judged]]
"""Results by family and depth error, in the order of seeds."""


def judge_hard(task: tuple[Path, System]) -> list[Judged]:
    """Run a system on all frames of a file; task of a worker."""
    path, system = task
    shots = load_shots(path)
    return [
        Judged(
            tally_of(shot, found, system.config),
            claim_of(shot, found, system.config),
            shot.depth.size,
        )
        for shot, found in zip(shots, found_by(system, Prepared(shots)), strict=True)
    ]


def specs_of(lab: Lab, family: str, error: float) -> list[Spec]:
    """Return the scenes of a family."""
    changes = {"depth_error": error} if error else {}
    return [
        lab.spec(family, seed, lab.counts.hard_scenes, "normal", **changes)
        for seed in lab.seeds[: lab.counts.hard_seeds]
    ]


def cells_of(lab: Lab) -> Cells:
    """Return the results of the default on all families."""
    keys = list(product(FAMILIES, ERRORS))
    specs = {key: specs_of(lab, *key) for key in keys}
    every = [spec for key in keys for spec in specs[key]]
    lab.log(f"{len(every)} frames of harder scenes")
    lab.store.ensure(every)
    system = default(lab.config)
    parts = iter(lab.run(judge_hard, [(lab.store.path(spec), system) for spec in every]))
    return {key: [one for _ in specs[key] for one in next(parts)] for key in keys}


def run(lab: Lab) -> Section:
    """Evaluate the default on harder families, without and with depth errors."""
    section = Section("hard", "Harder scenes")
    seeds, each = lab.seeds[: lab.counts.hard_seeds], lab.counts.hard_scenes
    section.say(
        "Families of the simulator with walls in range, objects of 6 to 20 cm, steps down, ramps, "
        f"tables, plain and reflective floors; {each * len(seeds)} scenes each, normal light, the "
        "mount of the log. Depth is without errors, or with the holes, blurred edges, stereo "
        "bowing, noise and reflections of a D435 on real floors. ACC, recall, precision and "
        "coverage as above. Free floor claimed: share of the pixels of drivable floor, measured "
        "within 4 m, that are inside the rectangle of a detection that does not hang (walls "
        f"included); worst frame: of those with at least {percent(LEAST_FLOOR, digits=0)} of such "
        "floor in the image."
    )
    cells = cells_of(lab)
    for error in ERRORS:
        rows = []
        for family in (*FAMILIES, "all"):
            chosen = FAMILIES if family == "all" else (family,)
            judged = [one for name in chosen for one in cells[name, error]]
            rows.append([family, *_row(section, f"{DEFAULT}.{family}.{error:g}", judged)])
        section.table(["Family", *COLUMNS], rows, f"Depth camera {CAMERAS[error]}")
    _add_claimed(section, f"{DEFAULT}.all", [one for cell in cells.values() for one in cell])
    _add_mounts(section, lab)
    _pictures(section, lab, cells)
    return section


def _add_mounts(section: Section, lab: Lab) -> None:
    """Add the figures of all families for lower or higher cameras, with the errors of a D435."""
    seeds, rows = lab.seeds[: lab.counts.mount_seeds], []
    specs = {
        (height, pitch): [
            lab.spec(
                family,
                seed,
                lab.counts.hard_scenes,
                "normal",
                camera_height_m=height,
                camera_pitch_rad=float(np.radians(pitch)),
                depth_error=ERRORS[-1],
            )
            for family, seed in product(FAMILIES, seeds)
        ]
        for height, pitch in HEIGHTS
    }
    lab.log(f"{sum(map(len, specs.values()))} frames of them from other heights")
    system = default(lab.config)
    for (height, pitch), every in specs.items():
        lab.store.ensure(every)
        parts = lab.run(judge_hard, [(lab.store.path(spec), system) for spec in every])
        judged = [one for part in parts for one in part]
        title = f"{height:g} m, {pitch:g}° down"
        rows.append([title, *_row(section, f"{DEFAULT}.{height:g}m.{pitch:g}deg", judged)])
    title = f"All families, {CAMERAS[ERRORS[-1]]}, mounted elsewhere"
    section.table(["Mounted", *COLUMNS], rows, title)


def _row(section: Section, key: str, judged: list[Judged]) -> list[str]:
    """Add the figures of some frames; return them as texts."""
    one = measured([frame.tally for frame in judged])
    cells = []
    for name, direction in FIGURES.items():
        section.add(f"{key}.{name}", one.value(name), "", direction, one.intervals[name])
        ends = one.intervals[name] if name == "accuracy" else None
        cells.append(percent(one.value(name), ends))
    share, worst = _add_claimed(section, key, judged)
    tally = one.score.tally
    mistakes = f"{tally.visible - tally.found:.0f} / {tally.false:.0f}"
    return [*cells, percent(share, digits=2), percent(worst), mistakes]


def _add_claimed(section: Section, key: str, judged: list[Judged]) -> tuple[float, float]:
    """Add the share of the floor inside outlines, over some frames and in the worst of them."""
    drivable = sum(frame.claim.drivable for frame in judged)
    claimed = sum(frame.claim.claimed for frame in judged)
    share = claimed / drivable if drivable else float("nan")
    worst = max((frame.claimed for frame in judged), default=float("nan"))
    section.add(f"{key}.claimed", share, "", "lower")
    section.add(f"{key}.claimed_worst", worst, "", "lower")
    return share, worst


def _pictures(section: Section, lab: Lab, cells: Cells) -> None:
    """Add pictures of the frames with the most errors, and with the most floor inside outlines."""
    system, each = default(lab.config), lab.counts.hard_scenes
    every = [(key, index, one) for key, cell in cells.items() for index, one in enumerate(cell)]
    orders = {
        "mistakes": lambda item: (item[2].mistakes, item[2].claimed),
        "claimed": lambda item: (item[2].claimed, item[2].mistakes),
    }
    for name, order in orders.items():
        worst = sorted(every, key=order, reverse=True)[: lab.counts.worst]
        views: list[np.ndarray] = []
        for (family, error), index, one in worst:
            if not any(order(((), 0, one))):
                continue
            spec = specs_of(lab, family, error)[index // each]
            shot = lab.load([spec])[index % each]
            tally = one.tally
            text = f"{shot.title}: {tally.visible - tally.found:.0f} of {tally.visible:.0f} missed"
            text += f", {tally.false:.0f} false, floor claimed {percent(one.claim.share)}"
            views.append(titled(shot_picture(shot, system), text, 640))
        if views:
            most = "missed and false" if name == "mistakes" else "floor claimed"
            caption = f"The frames with the most {most}."
            section.picture(name, encode(grid(views, 2)), caption)
