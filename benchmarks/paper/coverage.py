"""Coverage of the true obstacles by their rectangles."""

from benchmarks.paper.lab import Lab
from benchmarks.paper.measure import measured
from benchmarks.paper.plan import LIGHTS, SCENES
from benchmarks.paper.section import Section, number, percent
from benchmarks.paper.systems import DEFAULT, PAPER
from jaxdet.eval import score


def run(lab: Lab) -> Section:
    """Measure how much of the true footprints the rectangles cover, by light and scene."""
    section = Section("coverage", "Footprint coverage within 3 m")
    section.say(
        "Share of the points on the visible side of true footprints within 3 m of the camera that "
        "are inside the rectangle of their detection (with a tolerance of 2 cm), for obstacles "
        "that are found; 'any rectangle': for all required obstacles. Errors of position (forward, "
        "of point C) and width are medians (90th percentiles) in cm over the obstacles found. The "
        "true footprint contains everything between 5 cm and 2.2 m above the floor, with or "
        "without a measured depth. Simulated test scenes; the paper has no such figures."
    )
    groups = {
        "all": (SCENES, LIGHTS),
        **{light: (SCENES, (light,)) for light in LIGHTS},
        **{scene: ((scene,), LIGHTS) for scene in SCENES},
    }
    titles = {system.name: system.title for system in lab.systems}
    for name in (DEFAULT, PAPER):
        rows: list[list[str]] = []
        for group, (scenes, lights) in groups.items():
            tallies = lab.tallies(name, scenes, lights)
            one, full = measured(tallies), score(tallies).to_dict()
            for figure in ("coverage", "safe_coverage"):
                key, ends = f"{name}.{group}.{figure}", one.intervals[figure]
                section.add(key, one.value(figure), "", "higher", ends)
            for figure in ("position_error_m", "width_error_m"):
                section.add(f"{name}.{group}.{figure}", full[figure], "m", "lower")
            section.add(f"{name}.{group}.iou", full["iou"], "", "higher")
            rows.append(
                [
                    group,
                    percent(one.value("coverage"), one.intervals["coverage"]),
                    percent(one.value("safe_coverage"), one.intervals["safe_coverage"]),
                    _cm(full, "position_error"),
                    _cm(full, "width_error"),
                    number(full["iou"], digits=2),
                ]
            )
        header = [titles[name], "Own rectangle", "Any rectangle", "Position [cm]", "Width [cm]"]
        section.table([*header, "IoU"], rows)
    return section


def _cm(full: dict[str, float], name: str) -> str:
    return f"{100 * full[f'{name}_m']:.1f} ({100 * full[f'{name}_p90_m']:.1f})"
