"""Train the weights of the pairwise evidence, :data:`TABLES`, for ``jaxdet.affinity``.

    python -m benchmarks.affinity surfaces      from simulated scenes, and real frames with
                                                labelled boxes
    python -m benchmarks.affinity tabletop      from labelled frames of mOSD

The scenes have 21,570 frames, each of which takes about a second to render and process: hours on a
few cores, 13 minutes on 64.

The model is gradient boosting of the log-loss over pairs of surfaces (scikit-learn), with monotonic
constraints. Two surfaces belong together if most of their cells show the same object. The seeds of
the report's tests and the held-out frames are not used.
"""

import functools
import json
import math
import multiprocessing
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from sklearn.ensemble import HistGradientBoostingClassifier

from benchmarks.paper.hard import ERRORS, FAMILIES
from benchmarks.paper.labelled import (
    BOXES,
    RECORDINGS,
    SHARED_DATA,
    FrameBoxes,
    Recording,
    find_recordings,
    read_boxes,
)
from benchmarks.paper.main import start_worker
from benchmarks.paper.plan import SCENES
from benchmarks.paper.shots import Shot, Spec, drawn, frames_of
from benchmarks.paper.systems import eval_config
from benchmarks.scores.boxes import FLOOR
from jaxdet.affinity import BEYOND, FRACTION_BITS, GROWS, PAIR_FEATURES
from jaxdet.camera import cell_side
from jaxdet.config import Config
from jaxdet.cores import cores
from jaxdet.engine import decide_planes
from jaxdet.errors import InputError
from jaxdet.eval.frame import cell_points, objects_of
from jaxdet.floor.plane import floor_prior
from jaxdet.io import open_log
from jaxdet.presets import preset
from jaxdet.reference import surface_pairs
from jaxdet.reference._cells import cell_boxes
from jaxdet.types import Calibration, CellLabels, Cells, Features, Frames

TABLES = Path(__file__).parents[1] / "jaxdet" / "tables"
OLD = (*SCENES, "mixed")
OLD_SEEDS = (*range(900, 960), *range(2000, 2060))
HARD_SEEDS = (*range(900, 950), *range(2000, 2025))
CLOSE = ("room", "tables")
"""Families in which objects stand close together; more of their scenes are used."""
CLOSE_SEEDS, CLOSE_ONCE = range(2025, 2060), range(2150, 2200)
"""Seeds rendered with both cameras, and seeds rendered with one of them in turn."""
ROUNDS, FIRST = 395, 10_000
"""Number of rounds, and the seed of the first one. Each round has scenes of all families with one
camera, three times as many of the families ``CLOSE``."""
CROWDED = range(10_000, 12_500)
"""Seeds of the scenes in which small objects or furniture stand close together."""
CROWDED_MOUNTS = ((0.3, 10.0), (0.3, 10.0), (0.45, 20.0), (0.7, 30.0), (1.2, 35.0))
"""Height [m] and pitch [degree] of the camera in these scenes, by seed modulo their number."""
CROWDED_WEIGHT = 2.0
"""Weight of a pair from these scenes, relative to other simulated pairs."""
ROUND_LIGHTS = ("strong", "normal", "weaker", "dim", "strong")
"""Light of the scenes of ``SCENES``, by seed modulo the number of entries."""
NOISE_PER_M = 0.004
"""Noise of a D435, added to the frames of mOSD as a second variant: standard deviation divided by z
squared [1/m]."""
REAL = 20.0
"""Weight of a pair from a real frame, relative to simulated pairs, which are far more numerous."""
IN_FRONT_M, BEHIND_M = 0.15, 0.5
"""Cells in a box belong to its object if they are at most this much nearer or farther than it
[m]."""
ENOUGH = 100
"""Number of cells above which the weight of a surface is constant."""
MONOTONIC = [GROWS.get(name, 0) for name in PAIR_FEATURES]


class Learning(NamedTuple):
    """Parameters of the training, chosen by cross-validation over seeds or frames."""

    trees: int
    depth: int
    rate: float
    leaf: int
    """Minimum number of pairs in a leaf."""
    ridge: float
    """L2 penalty of the leaf values, which reduces those of leaves with few pairs."""
    bias: float
    """Log-odds added to the evidence, because pairs that are far apart are numerous but carry
    little information."""
    seed: int = 0
    """Seed of the choice of the examples whose quantiles are the candidate thresholds."""


LEARNING = {
    "surfaces": Learning(320, 6, 0.5, 30, 60.0, 0.8, seed=2),
    "tabletop": Learning(60, 4, 0.15, 20, 1.0, -0.5),
}


class Examples(NamedTuple):
    """Labelled pairs of surfaces."""

    seen: np.ndarray
    """Features of the pairs, ``(P, 26)`` int64."""
    same: np.ndarray
    """Whether both surfaces belong to one object, ``(P,)`` bool."""
    weight: np.ndarray
    """Weight, ``(P,)`` float64: square root of the cells of the smaller surface over the pairs in
    its frame."""


def examples(
    config: Config, frames: Frames, objects: Callable[[Cells, int], np.ndarray], walls: np.ndarray
) -> Examples:
    """Return the labelled pairs of surfaces of some frames.

    Args:
        config: Configuration of the surfaces.
        frames: Depth images, with the known floor of each frame if there is one.
        objects: Function that returns the object of each cell of a frame, ``(R, C)`` int64,
            0 = floor, -1 = unknown.
        walls: Whether an object is a wall, ``(J + 1,)`` bool; pairs of walls are left out.
    """
    parts = []
    for b, (grid, label, pairs) in enumerate(
        surface_pairs(frames, floor_prior(frames, config), config)
    ):
        known, count = objects(grid, b), int(label.max(initial=-1)) + 1
        on = (label >= 0) & (known >= 0)
        votes = np.zeros((count, len(walls)), np.int64)
        np.add.at(votes, (label[on], known[on]), 1)
        shows = np.where(votes.any(axis=1), votes.argmax(axis=1), -1)
        size = np.minimum(np.bincount(label[label >= 0], minlength=count), ENOUGH)
        one, other = shows[pairs.one], shows[pairs.other]
        used = (np.minimum(one, other) >= 0) & (np.maximum(one, other) > 0)
        used &= ~(walls[one] & walls[other])
        weight = np.sqrt(np.minimum(size[pairs.one], size[pairs.other]) / max(len(one), 1))
        parts.append(Examples(pairs.features[used], (one == other)[used], weight[used]))
    return joined(parts)


def joined(parts: Sequence[Examples]) -> Examples:
    """Concatenate examples."""
    return Examples(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def simulated(spec: Spec) -> Examples:
    """Render the scenes of a spec and return their pairs with their weights."""
    parts = []
    for shot in drawn(spec):
        walls = np.append(False, np.asarray(shot.truth.is_wall))
        seen_by = functools.partial(in_truth, shot)
        parts.append(examples(Config(), frames_of([shot]), seen_by, walls))
    found, factor = joined(parts), CROWDED_WEIGHT if spec.family == "crowded" else 1.0
    return found._replace(weight=factor * found.weight)


def scenes() -> Iterator[Spec]:
    """Yield the simulated scenes used for training."""
    for seed, family in product(OLD_SEEDS, OLD):
        yield Spec(family, seed, 2)
    for seed, family, error in product(HARD_SEEDS, FAMILIES, ERRORS):
        if error or family not in OLD:
            yield with_error(family, seed, error)
    for seed, family, error in product(CLOSE_SEEDS, CLOSE, ERRORS):
        yield with_error(family, seed, error)
    for seed, family in product(CLOSE_ONCE, CLOSE):
        yield with_error(family, seed, ERRORS[seed % 2])
    for number in range(ROUNDS):
        yield from of_round(number)
    for seed in CROWDED:
        yield with_mount(seed)


def of_round(number: int) -> Iterator[Spec]:
    """Yield two scenes of each family, and six of each close family."""
    seed = FIRST + number
    for family in FAMILIES:
        close = family in CLOSE
        for own in range(FIRST + 3 * number, FIRST + 3 * number + 3) if close else (seed,):
            yield with_error(family, own, ERRORS[own % 3 > 0])
    for family in SCENES:
        yield Spec(family, seed, 2, light=ROUND_LIGHTS[seed % len(ROUND_LIGHTS)])


def with_mount(seed: int) -> Spec:
    """Return the spec of two crowded scenes, seen from one of ``CROWDED_MOUNTS``."""
    height, pitch = CROWDED_MOUNTS[seed % len(CROWDED_MOUNTS)]
    mount = ("camera_height_m", height), ("camera_pitch_rad", math.radians(pitch))
    return Spec("crowded", seed, 2, changes=(("depth_error", ERRORS[seed % 3 > 0]), *mount))


def with_error(family: str, seed: int, error: float) -> Spec:
    """Return the spec of two hard scenes with a depth error."""
    return Spec(family, seed, 2, changes=(("depth_error", error),))


def learnt_scenes() -> Examples:
    """Return the pairs of all simulated scenes."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(cores(), context, initializer=start_worker) as pool:
        return joined(list(pool.map(simulated, scenes(), chunksize=8)))


def learnt_frames() -> Examples:
    """Return the pairs of the mOSD frames that are not held out, with and without added noise."""
    recording = next(one for one in RECORDINGS if one.name == "mosd")
    rng, parts, tabletop = np.random.default_rng(0), [], preset("tabletop")
    with open_log(str(SHARED_DATA / recording.place)) as log:
        batches = [batch.frames for batch in log.batches(1)]
    for frames in batches:
        number = int(frames.number[0])
        if recording.holds_out(number):
            continue
        path = SHARED_DATA / recording.images / f"{number:03d}.png"
        labels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if labels is None:
            raise InputError("the labels of a frame are missing", path=str(path))
        image = labels.astype(np.int64) - FLOOR
        unit, depth = frames.calibration.depth_unit, frames.depth
        side = cell_side(frames.calibration.depth, tabletop.surface.cell_rad)
        z = depth * unit
        noise = rng.normal(size=z.shape) * NOISE_PER_M * z * z / unit
        noisy = np.where(depth > 0, np.rint(depth + noise), 0).astype(np.uint16)
        none = np.zeros(int(image.max()) + 1, bool)
        for variant in (depth, noisy):
            seen_by = functools.partial(in_image, image, frames.calibration, side)
            parts.append(examples(tabletop, frames._replace(depth=variant), seen_by, none))
    return joined(parts)


def learnt_boxes() -> Examples:
    """Return the pairs of the real frames with labelled boxes that are not held out."""
    parts = []
    for recording, folder in find_recordings([SHARED_DATA]):
        path = BOXES / f"{recording.name}.txt"
        if path.is_file() and recording.learnt:
            parts += in_recording(recording, folder / recording.place, read_boxes(path))
    found = joined(parts)
    return found._replace(weight=REAL * found.weight)


def in_recording(
    recording: Recording, path: Path, boxes: dict[int, FrameBoxes]
) -> Iterator[Examples]:
    """Yield the pairs of each frame of a log that is labelled and not held out."""
    wheeled = preset("wheeled")
    with open_log(str(path)) as log:
        planes = decide_planes(log, wheeled, "reference")
        for batch in log.batches(1):
            number = int(batch.frames.number[0])
            if recording.holds_out(number) or number not in boxes:
                continue
            frames = batch.frames._replace(plane=planes.of(batch.frames.stamp_ns))
            outlined, distance = boxes[number].boxes, boxes[number].distance_m
            side = cell_side(frames.calibration.depth, wheeled.surface.cell_rad)
            camera = frames.calibration, side
            seen_by = functools.partial(in_boxes, outlined, distance, *camera)
            yield examples(wheeled, frames, seen_by, np.zeros(len(outlined) + 1, bool))


def in_boxes(
    boxes: np.ndarray,
    distance: np.ndarray,
    calibration: Calibration,
    side: int,
    grid: Cells,
    b: int,
) -> np.ndarray:
    """Return the object of each cell: the one whose box contains it at about its distance.

    Of several boxes, the smallest counts. Numbers start at 1; 0 means no object; -1 means unknown:
    outside of the image, or in a box but too near or too far for its object.
    """
    z = grid.z[b] * calibration.depth_unit
    u, v, in_view = middles(grid, b, calibration, side)
    out = np.where(in_view, 0, -1)
    sides = boxes[:, 2:] - boxes[:, :2]
    for k in np.argsort(-sides.prod(axis=1), kind="stable"):
        left, top, right, bottom = boxes[k]
        inside = in_view & (u >= left) & (u <= right) & (v >= top) & (v <= bottom)
        own = (z >= distance[k] - IN_FRONT_M) & (z <= distance[k] + BEHIND_M)
        out = np.where(inside & own, k + 1, np.where(inside & (out == 0), -1, out))
    return out


def in_image(
    image: np.ndarray, calibration: Calibration, side: int, grid: Cells, b: int
) -> np.ndarray:
    """Return the value of a label image at the middle of each cell, -1 = unknown."""
    u, v, in_view = middles(grid, b, calibration, side)
    return np.where(in_view, image[v, u], -1)


def middles(
    grid: Cells, b: int, calibration: Calibration, side: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return column and row of the middles of cells, and whether they are in the image."""
    low, high, in_view = (part[0] for part in cell_boxes(grid.z[b : b + 1], calibration, side))
    u, v = np.moveaxis((low + high) // 2, -1, 0)
    return u, v, in_view


def in_truth(shot: Shot, grid: Cells, b: int) -> np.ndarray:
    """Return the object on which each cell of a simulated frame was measured, -1 = unknown."""
    calibration, none = shot.calibration, np.zeros(grid.z.shape, np.int32)
    side = cell_side(calibration.depth, Config().surface.cell_rad)
    points = cell_points(CellLabels(none, none > 0, grid), b, calibration, side)
    flat = Features(*(part.ravel() for part in points[:-1]), overflow=points.overflow)
    unit = calibration.depth_unit
    found = objects_of(flat, shot.truth, 0, unit, eval_config(Config()))
    return np.where(points.valid, found.reshape(points.z.shape), -1)


def learn(found: Examples, how: Learning) -> dict[str, Any]:
    """Train a table for :func:`jaxdet.affinity.affinity`."""
    model = HistGradientBoostingClassifier(
        max_iter=how.trees,
        learning_rate=how.rate,
        max_depth=how.depth,
        max_leaf_nodes=1 << how.depth,
        min_samples_leaf=how.leaf,
        l2_regularization=how.ridge,
        monotonic_cst=MONOTONIC,
        random_state=how.seed,
    )
    model.set_params(early_stopping=False).fit(found.seen, found.same, found.weight)
    # scikit-learn has no public way to the trees of this model.
    trees = [complete(one.nodes, how.depth) for (one,) in model._predictors]
    feature, threshold, value = ([tree[k] for tree in trees] for k in range(3))
    offset = model._baseline_prediction.item() + how.bias
    return {
        "seen": PAIR_FEATURES,
        "offset": round(offset * (1 << FRACTION_BITS)),
        "feature": feature,
        "threshold": threshold,
        "value": value,
    }


def complete(nodes: np.ndarray, depth: int) -> tuple[list[int], list[int], list[int]]:
    """Expand a tree to full depth; return features and thresholds of its nodes, and leaf values."""
    inner = (1 << depth) - 1
    feature, threshold, value = [0] * inner, [BEYOND] * inner, [0] * (inner + 1)

    def fill(place: int, number: int) -> None:
        node = nodes[number]
        if place >= inner:
            value[place - inner] = round(float(node["value"]) * (1 << FRACTION_BITS))
            return
        split = not node["is_leaf"]
        if split:
            feature[place] = int(node["feature_idx"])
            threshold[place] = math.floor(node["num_threshold"])
        fill(2 * place + 1, node["left"] if split else number)
        fill(2 * place + 2, node["right"] if split else number)

    fill(0, 0)
    return feature, threshold, value


def write(name: str, table: dict[str, Any]) -> None:
    """Write a table to its JSON file, with one line per tree."""
    lines = [f'"{key}": {json.dumps(table[key])}' for key in ("seen", "offset")]
    for key in ("feature", "threshold", "value"):
        rows = ",\n".join(json.dumps(row) for row in table[key])
        lines.append(f'"{key}": [\n{rows}\n]')
    text = "{\n" + ",\n".join(lines) + "\n}\n"
    (TABLES / f"{name}.json").write_text(text, encoding="utf-8")


def main(arguments: Sequence[str]) -> None:
    """Train the table named on the command line."""
    if len(arguments) != 1 or arguments[0] not in LEARNING:
        sys.exit("usage: python -m benchmarks.affinity surfaces | tabletop")
    (name,) = arguments
    found = joined([learnt_scenes(), learnt_boxes()]) if name == "surfaces" else learnt_frames()
    write(name, learn(found, LEARNING[name]))
    print(f"{name}: {len(found.same)} pairs, {np.mean(found.same):.0%} of them one object")


if __name__ == "__main__":
    main(sys.argv[1:])
