"""Detections of the default with a wrong mount: pitch, height, roll, and a rocking robot."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.paper import plots
from benchmarks.paper.lab import Lab
from benchmarks.paper.measure import measured
from benchmarks.paper.plan import SCENES
from benchmarks.paper.section import Section, percent
from benchmarks.paper.shots import Shot, load_shots
from benchmarks.paper.systems import DEFAULT, Prepared, System, default, found_by, tally_of
from jaxdet.eval import Tally

WRONG_DEG = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0)


class Mount(NamedTuple):
    """Error of a mount: configured minus true."""

    name: str
    title: str
    height_m: float = 0.0
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    rock_rad: float = 0.0
    """Standard deviation of pitch and roll, which differ by frame."""

    def applied(self, shot: Shot) -> Shot:
        """Return the frame with the wrong mount."""
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
    """Run a system on all frames of a file with each mount; task of a worker."""
    path, system = task
    shots = load_shots(path)
    out: dict[str, list[Tally]] = {}
    for mount in MOUNTS:
        prepared = Prepared([mount.applied(shot) for shot in shots])
        out[mount.name] = [
            tally_of(shot, found, system.config)
            for shot, found in zip(shots, found_by(system, prepared), strict=True)
        ]
    return out


def run(lab: Lab) -> Section:
    """Measure ACC in the paper's four scenes in normal light, by error of the mount."""
    section = Section("mounts", "Wrong mounts")
    seeds = lab.seeds[: lab.counts.mount_seeds]
    specs = [
        lab.spec(scene, seed, lab.counts.scenes, "normal") for scene in SCENES for seed in seeds
    ]
    frames = sum(spec.frames for spec in specs)
    section.say(
        f"{frames} of the test frames in normal light ({len(seeds)} seeds of the four scenes), the "
        "same for each mount; errors are configured minus true values. Without a correction, too "
        "small a pitch makes distant floor an obstacle, and too large a pitch hides low objects; "
        "each frame corrects the mount. On a rocking robot, pitch and roll differ by frame."
    )
    lab.log(f"{frames} frames under {len(MOUNTS)} mounts")
    lab.store.ensure(specs)
    system = default(lab.config)
    parts = lab.run(judge_mounts, [(lab.store.path(spec), system) for spec in specs])
    found = {
        mount.name: measured([tally for part in parts for tally in part[mount.name]])
        for mount in MOUNTS
    }
    rows = []
    for mount in MOUNTS:
        one = found[mount.name]
        value, ends, tally = one.value("accuracy"), one.intervals["accuracy"], one.score.tally
        section.add(f"{DEFAULT}.{mount.name}.accuracy", value, "", "higher", ends)
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
    axes[0].set_xlabel("error of the pitch [°]")
    axes[0].set_ylim(-0.03, 1.03)
    plots.legend(figure, axes[0], 2)
    section.picture("pitch", plots.png(figure), "ACC by error of the pitch, with 95 % bands.")
    return section
