"""Family of scenes with walking people and crossing carts among static objects."""

from dataclasses import replace

import numpy as np

from jaxdet.sim.appearance import CONCRETE, WOOD, pick
from jaxdet.sim.draft import Draft
from jaxdet.sim.robot import pose_at
from jaxdet.sim.scene import Box, Model, Path, Scene

DURATION_S = 30.0
"""Time from the first frame during which moving objects do not collide [s]."""
_TIMES_S = np.arange(0.0, DURATION_S, 0.1)
_RADIUS_M = {"walker": 0.4, "cart": 0.6}
_CLEAR_M = 0.35
_ROBOT_M = 0.7


def moving(draft: Draft) -> Scene:
    """Draw one to three walking people, up to two carts, static objects and often a pillar.

    In half of the scenes the robot stands, else it drives back and forth.
    """
    rng = draft.rng
    path = Path(length=0.0)
    if rng.random() < 0.5:
        length, speed = rng.uniform((0.8, 0.25), (1.6, 0.6)).tolist()
        path = Path(length=length, speed=speed, weave=float(rng.uniform(0, 0.06)))
    trajectories = [(_trajectory(path), _ROBOT_M)]
    for _ in range(int(rng.integers(1, 3))):
        kind = str(rng.choice(["bin", "box", "bucket", "cone", "chair", "person"]))
        draft.add_object(kind, *draft.place(2.6, 4.0, 0.3))
    if rng.random() < 0.6:
        x, y = draft.place(2.0, 3.0, 0.25)
        side, turn = float(rng.uniform(0.2, 0.4)), float(rng.normal(0, 0.3))
        texture = pick(rng, CONCRETE, WOOD)
        draft.boxes.append(Box((x, y), (side, side, 1.9), turn, texture, name="pillar"))
    trajectories += [(np.array([[x, y]]), radius) for x, y, radius in draft.taken]
    kinds = ["cart"] * int(rng.integers(0, 3)) + ["walker"] * int(rng.integers(1, 4))
    for kind in kinds:
        _send(draft, kind, trajectories)
    scene = draft.finish("moving", outdoors=bool(rng.random() < 0.3))
    return replace(scene, path=path)


def _trajectory(path: Path) -> np.ndarray:
    """Return the positions of an object on a path at ``_TIMES_S``, ``(T, 2)`` [m]."""
    poses = [pose_at(path, float(t)) for t in _TIMES_S]
    return np.array([[pose.x, pose.y] for pose in poses])


def _send(draft: Draft, kind: str, trajectories: list[tuple[np.ndarray, float]]) -> None:
    """Add a moving model, unless no path without collisions is found."""
    radius = _RADIUS_M[kind]
    for _ in range(60):
        path = _crossing(draft.rng, kind)
        trajectory = _trajectory(path)
        gaps = [np.hypot(*(trajectory - other).T).min() - r for other, r in trajectories]
        if min(gaps) > radius + _CLEAR_M:
            trajectories.append((trajectory, radius))
            seed = int(draft.rng.integers(1 << 30))
            draft.models.append(Model(kind, seed=seed, path=path))
            return


def _crossing(rng: np.random.Generator, kind: str) -> Path:
    """Draw a path across the view; half of the people's paths approach the robot."""
    length, speed = rng.uniform((2.5, 0.6), (6.0, 1.5)).tolist()
    side = float(rng.choice([-1.0, 1.0]))
    if kind == "walker" and rng.random() < 0.5:
        start = rng.uniform((4.0, -1.2), (6.0, 1.2)).tolist()
        yaw = np.pi + float(rng.normal(0, 0.5))
        length = min(length, start[0] - 1.2)
    else:
        start = [float(rng.uniform(1.6, 3.9)), -side * length * float(rng.uniform(0.35, 0.65))]
        yaw = side * np.pi / 2 + float(rng.normal(0, 0.25))
    lead = float(rng.uniform(0.0, np.pi * length / speed))
    return Path((start[0], start[1]), yaw, length, speed, lead_s=lead)
