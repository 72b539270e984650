"""The user's own log with labels: the presets, the paper's rule and the baselines."""

from pathlib import Path
from typing import NamedTuple

from benchmarks.baselines import detect_with, prepare
from benchmarks.paper.lab import Lab
from benchmarks.paper.measure import measured
from benchmarks.paper.realframes import frames_with_floor
from benchmarks.paper.section import Section, number, percent
from benchmarks.paper.systems import DEFAULT, System
from jaxdet.cli.truth import score_against
from jaxdet.engine.device import method_frames
from jaxdet.errors import JaxdetError
from jaxdet.eval import Tally, score
from jaxdet.io import open_log
from jaxdet.pipeline import detect
from jaxdet.results.rows import to_host
from jaxdet.types import Detections, Frames


class Task(NamedTuple):
    """Method and log."""

    log: Path
    truth: Path
    system: System


class Judgement(NamedTuple):
    """Result of a method on a log."""

    tallies: list[Tally]
    """Counts of each frame with labels."""
    problem: str = ""
    """Reason why the log can't be compared; empty if it can."""


def run(lab: Lab) -> Section:
    """Compare the methods on the log of ``--log``."""
    section = Section("own", "Your own log")
    if lab.log_file is None or lab.truth is None:
        section.say("Not run: it needs --log LOG and --truth LABELS.json (or a simulated log).")
        return section
    section.say(
        f"{lab.log_file.name}, compared with {lab.truth.name} as by jaxdet run --truth; frames "
        "without labels don't count. The parameters of the rule and of the baselines (--rivals) "
        "were chosen on the simulated tuning scenes, not on this log. Intervals are too narrow, "
        "since the frames of a log are not independent."
    )
    tasks = [Task(lab.log_file, lab.truth, system) for system in lab.systems]
    rows: list[list[str]] = []
    for system, judged in zip(lab.systems, lab.run(judge, tasks), strict=True):
        if judged.problem:
            section.say(f"{system.title}: not compared: {judged.problem}")
            continue
        one, errors = measured(judged.tallies), score(judged.tallies)
        for figure in ("accuracy", "recall", "precision"):
            value, ends = one.value(figure), one.intervals[figure]
            section.add(f"{system.name}.{figure}", value, "", "higher", ends)
        section.add(f"{system.name}.error", errors.nearest_error_m, "m", "lower")
        tally = one.score.tally
        rows.append(
            [
                system.title,
                f"{tally.found:.0f} of {tally.visible:.0f}, {tally.false:.0f} false",
                *(percent(one.value(k), one.intervals[k]) for k in ("accuracy", "recall")),
                percent(one.value("precision"), one.intervals["precision"]),
                number(errors.nearest_error_m),
                system.params_text,
            ]
        )
    header = ["Method", "Found", "ACC", "Recall", "Precision", "Distance error, median [m]"]
    section.table([*header, "Parameters"], rows)
    return section


def judge(task: Task) -> Judgement:
    """Run a method on all frames of a log; task of a worker."""
    system, tallies = task.system, []
    try:
        compare = score_against(task.truth, system.config, 1)
        with open_log(str(task.log)) as log:
            for batch in frames_with_floor(log, system.config):
                if not batch.frames.valid.all():
                    continue
                one = compare(batch, _found(system, batch.frames))
                if isinstance(one, str):
                    return Judgement([], one)
                if one.frames:
                    tallies.append(one)
    except JaxdetError as error:
        return Judgement([], str(error))
    return Judgement(tallies, "" if tallies else "no frame of the log has labels")


def _found(system: System, frames: Frames) -> Detections:
    """Return the obstacles of a frame, a batch of one."""
    read = method_frames(frames, system.config)
    if system.method == DEFAULT:
        return to_host(detect(read, system.config, backend="jax", with_cells=True))
    (frame,) = prepare(read, system.config)
    return detect_with(system.baseline, frame, system.config, dict(system.params))
