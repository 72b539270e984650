"""Triangle mesh of a scene at a point in time, with the object of each triangle."""

from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np

from jaxdet.sim import shapes
from jaxdet.sim.ground import floor_mesh, standing
from jaxdet.sim.mesh import Mesh, join, shift
from jaxdet.sim.models import STRIDE_M, build_model
from jaxdet.sim.robot import pose_at
from jaxdet.sim.scene import Box, Cylinder, Ground, Model, Path, Scene, SceneObject, Wall
from jaxdet.sim.solid import hull_between

OUTLINE_CORNERS = 64
"""Maximum number of corners of a footprint."""
STEP_M, REACH_M = 0.05, 2.2
"""Minimum and maximum height of the parts of an object that count for its footprint [m], as a robot
could hit them. The wheels climb lower parts (the foot of a cone), and the robot passes under higher
parts."""
_WALL_FOOT_M = 1.5
"""Depth to which walls extend below z = 0 if the ground is not level [m]."""


Part = Literal["all", "opaque", "objects"]
"""Part of a world that is rendered; ``opaque``: without clear panes, ``objects``: without the
floor."""


class World(NamedTuple):
    """Mesh of a scene at a point in time."""

    mesh: Mesh
    """Mesh of all objects, the floor first."""
    object_of: np.ndarray
    """Number of the object of each triangle, ``(F,)`` int32, 0 = floor."""


def world_at(scene: Scene, time_s: float, part: Part = "all") -> World:
    """Return the world, or a part of it, at a time since the first frame; cached if static."""
    world = _world(scene, time_s if scene.moves else 0.0)
    if part == "all":
        return world
    mesh, object_of = world
    clear = np.array([texture.clear > 0 for texture in mesh.textures])[mesh.texture_index]
    kept = ~clear if part == "opaque" else object_of > 0
    faces = (mesh.corners[kept], mesh.normals[kept], mesh.places[kept], mesh.texture_index[kept])
    return World(Mesh(*faces, mesh.textures), object_of[kept])


@lru_cache(maxsize=4)
def _world(scene: Scene, time_s: float) -> World:
    parts = [floor_mesh(scene.ground, scene.floor)]
    parts += [object_mesh(scene, j, time_s) for j in range(len(scene.objects))]
    counts = [len(part.texture_index) for part in parts]
    return World(join(parts), np.repeat(np.arange(len(parts), dtype=np.int32), counts))


def object_mesh(scene: Scene, j: int, time_s: float) -> Mesh:
    """Return the mesh of object ``j`` (from 0) in the world at a time [s]."""
    return mesh_of(scene.objects[j], scene.ground, time_s)


def mesh_of(obj: SceneObject, ground: Ground, time_s: float = 0.0) -> Mesh:
    """Return the mesh of an object on the ground at a time [s]."""
    if isinstance(obj, Wall):
        foot = _WALL_FOOT_M if ground.slope_rad or ground.bump_m or ground.drop_m else 0.0
        return _box(obj.box, foot + ground.drop_m * ground.drop_steps)
    if isinstance(obj, Box):
        mesh, (x, y) = _box(obj, 0.0), obj.center
    elif isinstance(obj, Cylinder):
        mesh = shapes.cylinder(obj.radius, obj.height, obj.texture)
        (x, y) = obj.center
        mesh = mesh.moved(shift(x, y, obj.base))
    else:
        mesh, x, y = _model(obj, time_s)
    return mesh.moved(standing(ground, x, y))


def _box(box: Box, foot: float) -> Mesh:
    size = (*box.size[:2], box.size[2] + foot)
    mesh = shapes.box(size, box.texture)
    return mesh.moved(shift(*box.center, box.base - foot, box.yaw))


def _model(model: Model, time_s: float) -> tuple[Mesh, float, float]:
    x, y, yaw, phase = *model.center, model.yaw, 0.0
    if model.path is not None:
        x, y, yaw, travelled = _walk(model.path, time_s)
        phase = 2 * np.pi * travelled / STRIDE_M
    elif model.kind == "walker":
        phase = model.seed * 2.399963 % (2 * np.pi)
    mesh = _drawn(model.kind, model.seed, phase)
    if model.scale != 1:
        mesh = mesh.scaled(model.scale)
    return mesh.moved(shift(x, y, 0.0, yaw)), x, y


@lru_cache(maxsize=64)
def _drawn(kind: str, seed: int, phase: float) -> Mesh:
    return build_model(kind, seed, phase)


def _walk(path: Path, time_s: float) -> tuple[float, float, float, float]:
    pose = pose_at(path, time_s)
    backing = path.length > 0 and int(pose.travelled // path.length) % 2 == 1
    return pose.x, pose.y, pose.yaw + (np.pi if backing else 0.0), pose.travelled


def outline(mesh: Mesh, floor_z: float = 0.0) -> np.ndarray:
    """Compute the footprint of an object: its convex hull, seen from above.

    Only parts between STEP_M and REACH_M above the floor count; an object lower than STEP_M counts
    as a whole.

    Args:
        mesh: Object in the world.
        floor_z: World z of the floor under it [m].

    Returns:
        Corners ``(n, 2)`` float64 [m], counter-clockwise. If there are more than OUTLINE_CORNERS,
        the least significant are dropped, which moves the outline by less than 1 mm.
    """
    step, reach = floor_z + STEP_M, floor_z + REACH_M
    if mesh.corners[..., 2].max() <= step:
        step = -np.inf
    points = hull_between(mesh.corners, step, reach)
    while len(points) > OUTLINE_CORNERS:
        before, after = np.roll(points, 1, axis=0), np.roll(points, -1, axis=0)
        a, b = points - before, after - before
        points = np.delete(points, np.argmin(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), axis=0)
    return points


def bounds(mesh: Mesh, yaw: float = 0.0) -> np.ndarray:
    """Return the upright bounding box of a mesh, rotated by ``yaw``.

    Returns:
        Corners ``(8, 3)`` float64 [m]: bottom, then top, counter-clockwise from above.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s], [s, c]])
    points = mesh.corners.reshape(-1, 3)
    flat = points[:, :2] @ R
    (x0, y0), (x1, y1) = flat.min(0), flat.max(0)
    ring = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]) @ R.T
    z0, z1 = points[:, 2].min(), points[:, 2].max()
    low = np.column_stack([ring, np.full(4, z0)])
    return np.concatenate([low, low + np.array([0, 0, z1 - z0])])


def heading(scene: Scene, j: int, time_s: float) -> float:
    """Return the yaw of object ``j`` (from 0) at a time [rad]."""
    obj = scene.objects[j]
    if isinstance(obj, Model):
        return obj.yaw if obj.path is None else _walk(obj.path, time_s)[2]
    if isinstance(obj, Wall):
        return obj.box.yaw
    return obj.yaw if isinstance(obj, Box) else 0.0
