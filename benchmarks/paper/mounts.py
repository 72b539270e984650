"""Ours with a mount that is not as told: by pitch, height, roll, and on a robot that rocks."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.paper import plots
from benchmarks.paper.lab import Lab
from benchmarks.paper.measure import measured
from benchmarks.paper.plan import SCENES
from benchmarks.paper.section import Section, percent
from benchmarks.paper.shots import Shot, load_shots
from benchmarks.paper.systems import OURS, Prepared, System, found_by, ours, tally_of
from jaxdet.eval import Tally

WRONG_DEG = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0)


class Mount(NamedTuple):
    """How a told mount is wrong: told less true."""

    name: str
    title: str
    height_m: float = 0.0
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    rock_rad: float = 0.0
    """Standard deviation of pitch and roll, another one in each frame."""

    def told(self, shot: Shot) -> Shot:
        """The frame with the wrong mount."""
        seed = [shot.spec.seed, shot.number, *shot.spec.family.encode()]
        pitch, roll = (self.rock_rad * np.random.default_rng(seed).standard_normal(2)).tolist()
        height_m, pitch_rad, roll_rad = shot.mount
        return shot._replace(
            mount=(
                height_m + self.height_m,
                pitch_rad + self.pitch_rad + pitch,
                roll_rad + self.roll_rad + roll,
            )
        )


MOUNTS = (
    *(
        Mount(f"pitch{deg:+g}", f"pitch {deg:+g}°", pitch_rad=float(np.radians(deg)))
        for deg in WRONG_DEG
    ),
    Mount("height-3", "height -3 cm", height_m=-0.03),
    Mount("height+3", "height +3 cm", height_m=0.03),
    Mount("roll-2", "roll -2°", roll_rad=float(np.radians(-2.0))),
    Mount("roll+2", "roll +2°", roll_rad=float(np.radians(2.0))),
    Mount("rocks", "rocks, sd 0.7°", rock_rad=float(np.radians(0.7))),
)


def judge_mounts(task: tuple[Path, System]) -> dict[str, list[Tally]]:
    """A worker's task: a system on all frames of a file, under each mount."""
    path, system = task
    shots = load_shots(path)
    out: dict[str, list[Tally]] = {}
    for mount in MOUNTS:
        prepared = Prepared([mount.told(shot) for shot in shots])
        out[mount.name] = [
            tally_of(shot, found, system.config)
            for shot, found in zip(shots, found_by(system, prepared), strict=True)
        ]
    return out


def run(lab: Lab) -> Section:
    """ACC of the paper's four scenes in normal light by how wrong the told mount is."""
    section = Section("mounts", "A mount that is not as told (ours)")
    seeds = lab.seeds[: lab.counts.mount_seeds]
    specs = [
        lab.spec(scene, seed, lab.counts.scenes, "normal") for scene in SCENES for seed in seeds
    ]
    frames = sum(spec.frames for spec in specs)
    section.say(
        f"{frames} of the test frames in normal light ({len(seeds)} seeds of the four scenes), the "
        "same for each mount: told less true. Taken as it is, a pitch told too small lets the "
        "floor rise in the picture, and one told too large hides low things; each frame corrects "
        "it. A robot that rocks has another pitch and roll in each frame than is told."
    )
    lab.log(f"{frames} frames under {len(MOUNTS)} mounts")
    lab.store.ensure(specs)
    system = ours(lab.config)
    parts = lab.run(judge_mounts, [(lab.store.path(spec), system) for spec in specs])
    found = {
        mount.name: measured([tally for part in parts for tally in part[mount.name]])
        for mount in MOUNTS
    }
    rows = []
    for mount in MOUNTS:
        one = found[mount.name]
        value, ends, tally = one.value("accuracy"), one.intervals["accuracy"], one.score.tally
        section.add(f"{OURS}.{mount.name}.accuracy", value, "", "higher", ends)
        mistakes = f"{tally.visible - tally.found:.0f} / {tally.false:.0f}"
        rows.append([mount.title, percent(value, ends), mistakes])
    section.table(["Told less true", "ACC", "missed / false"], rows)
    figure, axes = plots.canvas(1, 7, 3.6)
    names = [f"pitch{deg:+g}" for deg in WRONG_DEG]
    series = {
        system.title: plots.Series(
            [found[name].value("accuracy") for name in names],
            [found[name].intervals["accuracy"].low for name in names],
            [found[name].intervals["accuracy"].high for name in names],
        )
    }
    plots.lines(axes[0], WRONG_DEG, series, "ACC")
    axes[0].set_xlabel("pitch told less true [°]")
    axes[0].set_ylim(-0.03, 1.03)
    plots.legend(figure, axes[0], 2)
    section.picture("pitch", plots.png(figure), "ACC by the told pitch's error, bands 95 %.")
    return section
