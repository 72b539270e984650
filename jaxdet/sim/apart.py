"""Things that a scene has drawn into each other are put beside each other."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jaxdet.sim.scene import Box, Cylinder, Model, Path, Scene, Thing, rotation_z
from jaxdet.sim.solid import Solid, intersect, solid_of, swept
from jaxdet.sim.world import thing_mesh

TRIES = 60
CLEAR_M = 0.10
"""What is put elsewhere keeps so far from all that stands: the least gap at which the report asks
for two things to be told apart [m]."""
_FARTHER_M = 0.05
"""Each try is up to so much farther from the first place than the one before [m]."""
_LIMITS_M = (0.9, 4.4)
"""Distances ahead of what is close to the robot and what is out of range [m]; things stay there."""
_EDGE_M = 0.3
"""Things keep so far from steps down [m]."""


def apart(scene: Scene, seed: int) -> Scene:
    """The scene with no two solid things in each other.

    The larger of two stays. The smaller is put in another place near its own, drawn from its own
    stream, so that a scene in which nothing is in another thing stays as it is; where ``TRIES``
    places are taken, it is left out. Walls stay, and so do the ways of what moves (some lead out of
    a hall through its wall): what stands keeps out of them.

    Args:
        scene: As drawn.
        seed: Of the streams.
    """
    things = (*scene.boxes, *scene.cylinders, *scene.models)
    taken = [_solid(wall, scene) for wall in scene.walls]
    solids = [_solid(thing, scene) for thing in things]
    kept: dict[int, Box | Cylinder | Model] = {}
    for j in sorted(range(len(things)), key=lambda j: (not _moves(things[j]), -_size(solids[j]))):
        thing, solid = things[j], solids[j]
        if not _moves(thing) and any(intersect(solid, other) for other in taken):
            for thing in _elsewhere(things[j], scene, np.random.default_rng([seed, j, *b"apart"])):
                solid = _solid(thing, scene)
                if not any(intersect(solid, other, CLEAR_M) for other in taken):
                    break
            else:
                continue
        kept[j] = thing
        taken.append(solid)
    left = [kept[j] for j in sorted(kept)]
    if left == list(things):
        return scene
    kinds = {"boxes": Box, "cylinders": Cylinder, "models": Model}
    return replace(
        scene, **{n: tuple(t for t in left if isinstance(t, k)) for n, k in kinds.items()}
    )


def _moves(thing: Thing) -> bool:
    return isinstance(thing, Model) and thing.path is not None


def _size(solid: Solid) -> float:
    """Volume of the upright box around a thing [m^3]."""
    if not len(solid.box):
        return 0.0
    return float(np.prod(solid.box[:, 1].max(axis=0) - solid.box[:, 0].min(axis=0)))


def _solid(thing: Thing, scene: Scene) -> Solid:
    if isinstance(thing, Model) and thing.path is not None:
        times = _there_and_back(thing.path)
        return swept([thing_mesh(thing, scene.ground, time) for time in times])
    return solid_of(thing_mesh(thing, scene.ground))


def _there_and_back(path: Path) -> list[float]:
    """Times at which a thing is at both ends of its way and between them, in both directions."""
    period = np.pi * path.length / path.speed
    return (np.arange(16) / 16 * period - path.lead_s).tolist()


def _elsewhere(
    thing: Box | Cylinder | Model, scene: Scene, rng: np.random.Generator
) -> Iterator[Box | Cylinder | Model]:
    """The thing at places around its own that are like it."""
    where = _where(scene, *thing.center)
    for k in range(TRIES):
        angle, far = rng.uniform(0, 2 * np.pi), _FARTHER_M * (k + 1) * np.sqrt(rng.uniform())
        x, y = thing.center[0] + far * np.cos(angle), thing.center[1] + far * np.sin(angle)
        if _where(scene, x, y) == where and not _behind_wall(scene, x, y):
            yield replace(thing, center=(float(x), float(y)))


def _where(scene: Scene, x: float, y: float) -> tuple[int, ...]:
    """Near the robot, in range or beyond it; on which of the floor's levels."""
    along = float(rotation_z(-scene.ground.slope_yaw)[0] @ (x, y))
    edges = [along + side for side in (-_EDGE_M, _EDGE_M)]
    levels = np.searchsorted(scene.ground.edges_m, edges).tolist()
    return (int(np.searchsorted(_LIMITS_M, x)), *levels)


def _behind_wall(scene: Scene, x: float, y: float) -> bool:
    """Whether a wall stands between the robot and a place."""

    def side(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
        return (b[0] - a[0]) * (c[1] - a[1]) > (b[1] - a[1]) * (c[0] - a[0])

    robot, place = (0.0, 0.0), (x, y)
    return any(
        side(wall.start, wall.end, robot) != side(wall.start, wall.end, place)
        and side(robot, place, wall.start) != side(robot, place, wall.end)
        for wall in scene.walls
    )
