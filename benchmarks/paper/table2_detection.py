"""Table 2: are the obstacles found? All baselines on all test scenes."""

from benchmarks.baselines import BASELINES
from benchmarks.paper import paper_figures, plots
from benchmarks.paper.lab import Lab
from benchmarks.paper.measure import measured
from benchmarks.paper.section import Section, number, percent
from benchmarks.paper.systems import JOINED, LEARNT, MISSING, OURS, PAPER

PAPER_ROWS = {"hierarchical_ward": "traditional", "rsc": "rsc", OURS: "ours", PAPER: "ours"}
SHOWN = ("accuracy", "fmi", "f1")


def run(lab: Lab) -> Section:
    """Table 2 (ACC and FMI of every method), with F1, precision, recall, splits and merges."""
    section = Section("table2", "Table 2: detection of obstacles")
    frames = sum(len(tallies[OURS]) for tallies in lab.scores.values())
    section.say(
        f"{frames} simulated frames: the four scenes in the four lights, seeds {lab.seeds[0]} to "
        f"{lab.seeds[-1]}; the paper has 100 images of its own robot. ACC is TP / (TP + FP + FN) "
        "over obstacles, FMI the Fowlkes-Mallows index over points, mean of the frames. The "
        "mount is what is known of the floor; each frame corrects it, but for the preset paper. "
        "All baselines get the same points above that floor: the corners of our default and the "
        "pixels of a grid of 80 columns; each one's parameters were chosen on the tuning seeds for "
        "the mean of ACC, FMI and F1 (the last column), from a grid and beyond it as long as that "
        f"helped. Ours are the default's. {LEARNT} FMI is over a method's own points, those of the "
        "default are corners and cells. CURE, ROCK and CHAMELEON cluster a random sample of 256 "
        "points, DDC and DCC of 160, described by position and grey patch; all other points follow "
        "the nearest of the sample, as each method has it. The preset paper has its own "
        "preprocessing and asks for obstacles to its own range of 3 m. 'joined' scores on the "
        "truth in which obstacles that the robot can't pass between count as one, the paper's own "
        "definition, which favours rules with its gaps."
    )
    rows: list[list[str]] = []
    for system in lab.systems:
        one = measured(lab.tallies(system.name))
        other = measured(lab.tallies(JOINED + system.name))
        theirs = paper_figures.DETECTION.get(PAPER_ROWS.get(system.name, ""))
        for k, figure in enumerate(("accuracy", "fmi", "f1", "precision", "recall")):
            paper = theirs[k] if theirs and k < 2 else None
            key, ends = f"{system.name}.{figure}", one.intervals[figure]
            section.add(key, one.value(figure), "", "higher", ends, paper)
            if figure in SHOWN:
                value, ends = other.value(figure), other.intervals[figure]
                section.add(f"{system.name}.joined.{figure}", value, "", "higher", ends)
        tally = one.score.tally
        rows.append(
            [
                system.title,
                percent(one.value("accuracy"), one.intervals["accuracy"]),
                number(one.value("fmi"), one.intervals["fmi"]),
                number(one.value("f1"), one.intervals["f1"]),
                percent(one.value("precision")),
                percent(one.value("recall")),
                f"{tally.splits:.0f} / {tally.merges:.0f}",
                f"{percent(other.value('accuracy'))}, {number(other.value('fmi'))}",
                f"{100 * theirs[0]:.2f} %, {theirs[1]:.4f}" if theirs else "",
                ", ".join(f"{k} {_short(v)}" for k, v in system.params),
            ]
        )
    header = ["Method", "ACC", "FMI", "F1", "Precision", "Recall", "Splits / merges"]
    header += ["joined: ACC, FMI", "the paper: ACC, FMI", "Tuned parameters"]
    rows += [
        [BASELINES[name].title, *[""] * (len(header) - 2), f"not run: {reason}"]
        for name, reason in MISSING.items()
    ]
    section.table(header, rows)
    _plot(section, lab)
    return section


def _short(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _plot(section: Section, lab: Lab) -> None:
    found = {system.title: measured(lab.tallies(system.name)) for system in lab.systems}
    order = sorted(found, key=lambda title: -found[title].value("accuracy"))
    figure, axes = plots.canvas(1, 10, 5.2)
    series = {
        label: plots.Series(
            [found[title].value(name) for title in order],
            [found[title].intervals[name].low for title in order],
            [found[title].intervals[name].high for title in order],
        )
        for label, name in (("ACC", "accuracy"), ("FMI", "fmi"), ("F1", "f1"))
    }
    plots.bars(axes[0], order, series, "")
    axes[0].set_xticks(range(len(order)), order, rotation=35, ha="right")
    axes[0].set_ylim(0, 1)
    plots.legend(figure, axes[0], 3)
    section.picture("methods", plots.png(figure), "All methods on all test frames, best ACC first.")
