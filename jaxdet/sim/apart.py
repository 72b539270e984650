"""Relocation of objects that intersect in a random scene."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jaxdet.sim.scene import Box, Cylinder, Model, Path, Scene, SceneObject, rotation_z
from jaxdet.sim.solid import Solid, intersect, solid_of, swept
from jaxdet.sim.world import mesh_of

TRIES = 60
CLEAR_M = 0.10
"""Minimum gap between a relocated object and all other objects [m]: at this gap, boxes should still
be detected as two obstacles."""
_FARTHER_M = 0.05
"""Increase of the search radius per try [m]."""
_LIMITS_M = (0.9, 4.4)
"""Distances ahead that separate close, in-range and far objects [m]; no object is moved from one of
these ranges to another."""
_EDGE_M = 0.3
"""Minimum distance from steps down [m]."""


def apart(scene: Scene, seed: int) -> Scene:
    """Return a scene without intersecting solid objects.

    The larger of two objects stays. The smaller is moved to a random position nearby, or dropped if
    ``TRIES`` positions are occupied. Positions are drawn from a separate random stream per object,
    so that scenes without intersections don't change. Walls and the paths of moving objects stay
    (some paths lead through the wall of a hall); static objects that intersect them are moved.

    Args:
        scene: Random scene.
        seed: Seed of the streams.
    """
    objects = (*scene.boxes, *scene.cylinders, *scene.models)
    taken = [_solid(wall, scene) for wall in scene.walls]
    solids = [_solid(obj, scene) for obj in objects]
    kept: dict[int, Box | Cylinder | Model] = {}
    for j in sorted(range(len(objects)), key=lambda j: (not _moves(objects[j]), -_size(solids[j]))):
        obj, solid = objects[j], solids[j]
        if not _moves(obj) and any(intersect(solid, other) for other in taken):
            for obj in _elsewhere(objects[j], scene, np.random.default_rng([seed, j, *b"apart"])):
                solid = _solid(obj, scene)
                if not any(intersect(solid, other, CLEAR_M) for other in taken):
                    break
            else:
                continue
        kept[j] = obj
        taken.append(solid)
    left = [kept[j] for j in sorted(kept)]
    if left == list(objects):
        return scene
    kinds = {"boxes": Box, "cylinders": Cylinder, "models": Model}
    return replace(
        scene, **{n: tuple(t for t in left if isinstance(t, k)) for n, k in kinds.items()}
    )


def _moves(obj: SceneObject) -> bool:
    return isinstance(obj, Model) and obj.path is not None


def _size(solid: Solid) -> float:
    """Return the volume of an object's bounding box [m^3]."""
    if not len(solid.box):
        return 0.0
    return float(np.prod(solid.box[:, 1].max(axis=0) - solid.box[:, 0].min(axis=0)))


def _solid(obj: SceneObject, scene: Scene) -> Solid:
    if isinstance(obj, Model) and obj.path is not None:
        times = _there_and_back(obj.path)
        return swept([mesh_of(obj, scene.ground, time) for time in times])
    return solid_of(mesh_of(obj, scene.ground))


def _there_and_back(path: Path) -> list[float]:
    """Return times that sample an object's path in both directions, ends included."""
    period = np.pi * path.length / path.speed
    return (np.arange(16) / 16 * period - path.lead_s).tolist()


def _elsewhere(
    obj: Box | Cylinder | Model, scene: Scene, rng: np.random.Generator
) -> Iterator[Box | Cylinder | Model]:
    """Yield copies of an object at random positions near its position, in the same zone."""
    where = _where(scene, *obj.center)
    for k in range(TRIES):
        angle, far = rng.uniform(0, 2 * np.pi), _FARTHER_M * (k + 1) * np.sqrt(rng.uniform())
        x, y = obj.center[0] + far * np.cos(angle), obj.center[1] + far * np.sin(angle)
        if _where(scene, x, y) == where and not _behind_wall(scene, x, y):
            yield replace(obj, center=(float(x), float(y)))


def _where(scene: Scene, x: float, y: float) -> tuple[int, ...]:
    """Return the zone of a position: close, in range or beyond, and the level of the floor."""
    along = float(rotation_z(-scene.ground.slope_yaw)[0] @ (x, y))
    edges = [along + side for side in (-_EDGE_M, _EDGE_M)]
    levels = np.searchsorted(scene.ground.edges_m, edges).tolist()
    return (int(np.searchsorted(_LIMITS_M, x)), *levels)


def _behind_wall(scene: Scene, x: float, y: float) -> bool:
    """Return whether a wall is between the robot and a position."""

    def side(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
        return (b[0] - a[0]) * (c[1] - a[1]) > (b[1] - a[1]) * (c[0] - a[0])

    robot, place = (0.0, 0.0), (x, y)
    return any(
        side(wall.start, wall.end, robot) != side(wall.start, wall.end, place)
        and side(robot, place, wall.start) != side(robot, place, wall.end)
        for wall in scene.walls
    )
