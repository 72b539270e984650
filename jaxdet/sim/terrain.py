"""Families of scenes with low objects, steps down and ramps."""

import numpy as np

from jaxdet.sim.appearance import (
    CARTON,
    CONCRETE,
    WHITE_BOX,
    Texture,
    pick,
    tinted,
)
from jaxdet.sim.draft import Draft, building, hard_floor, inner_wall, room
from jaxdet.sim.scene import Box, Cylinder, Ground, Model, Scene


def low_clutter(draft: Draft) -> Scene:
    """Draw three to six objects of 6 to 20 cm, indoors or outdoors."""
    rng = draft.rng
    kinds = ["small box", "small box", "brick", "kerb", "bottle", "cable_drum"]
    for _ in range(int(rng.integers(3, 7))):
        place_low(draft, str(rng.choice(kinds)), *draft.place(0.9, 3.3, 0.2, gap=0.2))
    outdoors = bool(rng.random() < 0.35)
    left, right, front = rng.uniform((1.3, 1.3, 2.8), (4.5, 4.5, 8.0)).tolist()
    walls = building(rng) if outdoors else room(inner_wall(rng), left, right, front)
    return draft.enclosed("low_clutter", walls, hard_floor(rng, outdoors=outdoors))


def place_low(draft: Draft, kind: str, x: float, y: float) -> None:
    """Place an object of at most 20 cm: a small box, brick, kerb, bottle or cable drum."""
    rng = draft.rng
    yaw = float(rng.uniform(-np.pi, np.pi))
    if kind == "small box":
        texture = pick(rng, CARTON, WHITE_BOX, Texture("plain", tinted(rng, (150, 140, 130), 40)))
        size = 0.15, float(rng.uniform(0.12, 0.2)), float(rng.uniform(0.06, 0.2))
        draft.boxes.append(Box((x, y), size, yaw, texture, name="small box"))
    elif kind == "brick":
        clay = Texture("noise", tinted(rng, (164, 84, 62), 8), (120, 60, 46), 0.2, 5.0)
        # DIN 105 NF, lying on one of its faces.
        size = ((0.115, 0.24, 0.071), (0.071, 0.24, 0.115), (0.071, 0.24, 0.071))[rng.integers(3)]
        draft.boxes.append(Box((x, y), size, yaw, clay, name="brick"))
    elif kind == "kerb":
        size = 0.15, float(rng.uniform(0.5, 1.2)), float(rng.uniform(0.06, 0.15))
        turn = float(rng.normal(0, 0.5))
        draft.boxes.append(Box((x, y), size, turn, CONCRETE, name="kerb"))
    elif kind == "bottle":
        texture = Texture("plain", tinted(rng, (70, 110, 80), 30), gloss=0.4)
        radius, height = rng.uniform((0.03, 0.15), (0.045, 0.20)).tolist()
        draft.cylinders.append(Cylinder((x, y), radius, height, texture, name="bottle"))
    else:
        draft.models.append(Model(kind, (x, y), yaw, int(rng.integers(1 << 30))))


def drops(draft: Draft) -> Scene:
    """Draw a step down of 5 to 40 cm, stairs down, or the end of the floor, 1 to 3 m ahead."""
    rng = draft.rng
    kind = str(rng.choice(["kerb", "step", "stairs", "end"]))
    deep = {"kerb": (0.05, 0.15), "step": (0.15, 0.4), "stairs": (0.14, 0.19), "end": (0.8, 1.5)}
    start, yaw = float(rng.uniform(1.0, 3.0)), float(rng.normal(0, 0.25))
    steps = int(rng.integers(2, 8)) if kind == "stairs" else 1
    ground = Ground(
        slope_yaw=yaw,
        drop_m=float(rng.uniform(*deep[kind])),
        drop_start_m=start,
        drop_steps=steps,
        drop_tread_m=float(rng.uniform(0.26, 0.32)),
    )
    side = np.array([-np.sin(yaw), np.cos(yaw)])
    for _ in range(int(rng.integers(1, 3))):
        # Objects keep clear of the edge. Beyond it are only people, as they are tall enough to be
        # visible above it.
        before = start > 1.7 and rng.random() < 0.6
        beyond = start + 0.6 + 0.32 * steps
        low, high = (1.0, start - 0.6) if before else (beyond, beyond + 1.5)
        along, half = float(rng.uniform(low, high)), 0.35
        place = along * np.array([np.cos(yaw), np.sin(yaw)])
        x, y = (place + float(rng.uniform(-half, half)) * along * side).tolist()
        if all(np.hypot(x - a, y - b) > 0.5 + r for a, b, r in draft.taken):
            draft.taken.append((x, y, 0.25))
            kinds = ["box", "bin", "cone", "person", "pole", "bucket"]
            draft.add_object(str(rng.choice(kinds)) if before else "person", x, y)
    outdoors = bool(rng.random() < 0.5)
    left, right, front = rng.uniform((1.3, 1.3, 5.0), (4.0, 4.0, 9.0)).tolist()
    walls = building(rng) if outdoors else room(inner_wall(rng), left, right, front)
    return draft.enclosed("drops", walls, hard_floor(rng, outdoors=outdoors), ground)


def ramps(draft: Draft) -> Scene:
    """Draw a ramp of 3 to 8 degrees up or down, ahead or under the robot, with objects."""
    rng = draft.rng
    slope = float(np.radians(rng.uniform(3, 8)) * rng.choice([-1, 1]))
    under = bool(rng.random() < 0.2)
    ground = Ground(
        slope_rad=slope,
        slope_start_m=-2.5 if under else float(rng.uniform(0.7, 2.4)),
        slope_length_m=200.0 if under else float(rng.choice([200.0, rng.uniform(1.2, 4.0)])),
        slope_yaw=float(rng.normal(0, 0.2)),
        bump_m=float(rng.choice([0.0, 0.0, 0.005])),
        seed=int(rng.integers(1000)),
    )
    kinds = ["box", "box", "bin", "cone", "person", "pole", "chair", "bucket", "brick"]
    for _ in range(int(rng.integers(2, 5))):
        draft.add_object(str(rng.choice(kinds)), *draft.place(1.1, 3.7, 0.27, gap=0.3))
    outdoors = bool(rng.random() < 0.5)
    left, right, front = rng.uniform((1.5, 1.5, 4.0), (4.0, 4.0, 7.0)).tolist()
    walls = building(rng) if outdoors else room(inner_wall(rng), left, right, front)
    return draft.enclosed("ramps", walls, hard_floor(rng, outdoors=outdoors), ground)
