"""Ours against every clustering baseline, in every scene and light, with intervals."""

from collections.abc import Sequence

from benchmarks.paper.lab import Lab
from benchmarks.paper.measure import Difference, differences
from benchmarks.paper.plan import LIGHTS, SCENES
from benchmarks.paper.systems import OURS

FIGURES = ("accuracy", "fmi", "f1")
Verdict = tuple[str, str, str, bool | None]
"""Key, text, figure, reached."""


def against(lab: Lab) -> list[Difference]:
    """All differences: a scene's are over all lights with the scene as the unit."""
    lab.log("differences to the baselines")
    found: list[Difference] = []
    groups = {scene: ((scene,), LIGHTS) for scene in SCENES}
    groups |= {light: (SCENES, (light,)) for light in LIGHTS}
    for condition, (scenes, lights) in groups.items():
        ours = lab.tallies(OURS, scenes, lights)
        for rival in lab.rivals:
            theirs = lab.tallies(rival, scenes, lights)
            found += differences(condition, rival, ours, theirs, FIGURES)
    return found


def beating(found: Sequence[Difference]) -> list[Verdict]:
    """Whether ours is better than every baseline, by the figures and by their intervals."""
    names = {"accuracy": "ACC", "fmi": "FMI", "f1": "F1"}
    verdicts: list[Verdict] = []
    for figure, label in names.items():
        mine = [one for one in found if one.figure == figure]
        text = f"{label} better than every clustering baseline in every scene and light"
        if not mine:
            verdicts.append((f"beats.{figure}", text, "", None))
            continue
        better = sum(one.value > 0 for one in mine)
        sure = sum(one.interval.low > 0 for one in mine)
        worst = min(mine, key=lambda one: one.value)
        low, high = worst.interval
        shown = (
            f"{better} of {len(mine)} differences above 0, {sure} with the whole interval; least "
            f"{worst.value:+.3f} [{low:+.3f}, {high:+.3f}] to {worst.rival} in {worst.condition}"
        )
        verdicts.append((f"beats.{figure}", text, shown, better == len(mine)))
        text = f"{label}: the whole interval of each difference above 0"
        verdicts.append((f"beats.{figure}.sure", text, f"{sure} of {len(mine)}", sure == len(mine)))
    return verdicts
