"""Built-in scenes of the simulator, and scenes from TOML or JSON files."""

from dataclasses import replace
from math import pi

from jaxdet.errors import ConfigError
from jaxdet.sim.appearance import (
    BLUE_BIN,
    BUCKET,
    CARPET,
    CARTON,
    DARK_CASE,
    PLASTER,
    POST,
    RED_CRATE,
    TILES,
    WHITE_BOX,
    WOOD,
)
from jaxdet.sim.config import SimConfig
from jaxdet.sim.families import FAMILIES, make_scene
from jaxdet.sim.scene import Box, Cylinder, Model, Path, Scene, Wall
from jaxdet.sim.scenefile import read_scene


def _room(left: float, right: float, back: float, front: float) -> tuple[Wall, ...]:
    corners = [(back, right), (front, right), (front, left), (back, left)]
    ends = [*corners[1:], corners[0]]
    pairs = zip(corners, ends, strict=True)
    return tuple(Wall(a, b, texture=PLASTER, name=f"wall {i}") for i, (a, b) in enumerate(pairs))


def _demo() -> Scene:
    boxes = (
        Box((1.75, 0.42), (0.28, 0.34, 0.24), 0.25, CARTON, name="carton"),
        Box((2.75, -0.62), (0.30, 0.42, 0.46), -0.15, DARK_CASE, name="case"),
        Box((3.85, 0.75), (0.34, 0.50, 0.62), 0.10, RED_CRATE, name="crate"),
        Box((5.05, -0.95), (0.40, 0.40, 0.50), 0.5, WHITE_BOX, name="white box"),
    )
    cylinders = (
        Cylinder((1.30, -0.30), 0.045, 0.75, POST, name="post"),
        Cylinder((2.25, 0.05), 0.13, 0.26, BUCKET, name="bucket"),
        Cylinder((3.30, 0.02), 0.06, 0.95, POST, name="tall post"),
        Cylinder((4.50, 0.15), 0.20, 0.58, BLUE_BIN, name="bin"),
    )
    path = Path(length=2.2, speed=0.45, weave=0.06, weave_length=3.0)
    return Scene(
        "demo", boxes, cylinders, walls=_room(3.4, -3.4, -3.0, 9.5), floor=TILES, path=path
    )


def _drive() -> Scene:
    boxes = (
        Box((1.85, -0.50), (0.30, 0.36, 0.26), 0.25, CARTON, name="carton"),
        Box((3.05, -0.95), (0.34, 0.46, 0.52), -0.15, DARK_CASE, name="case"),
        Box((6.50, 0.25), (0.40, 0.60, 0.66), 0.10, RED_CRATE, name="crate"),
        Box((7.60, -0.75), (0.40, 0.40, 0.50), 0.5, WHITE_BOX, name="white box"),
    )
    cylinders = (
        Cylinder((2.20, 0.85), 0.13, 0.28, BUCKET, name="bucket"),
        Cylinder((3.45, 0.75), 0.20, 0.58, BLUE_BIN, name="bin"),
        Cylinder((5.30, -0.65), 0.06, 0.95, POST, name="post"),
    )
    across = Path(start=(4.4, -2.4), yaw=pi / 2, length=4.8, speed=0.94)
    person = Model("walker", seed=1, path=across, name="person")
    path = Path(length=5.0, speed=pi / 4, weave=0.12, weave_length=5.0)
    walls = _room(3.6, -3.6, -3.0, 10.0)
    return Scene("drive", boxes, cylinders, (person,), walls=walls, floor=TILES, path=path)


def _single_box() -> Scene:
    box = Box((1.5, 0.0), (0.30, 0.40, 0.40), 0.0, CARTON, name="carton")
    walls = _room(4.0, -4.0, -3.0, 8.0)
    return Scene("single_box", (box,), walls=walls, floor=WOOD, path=Path(length=0.0))


def _row() -> Scene:
    textures = (CARTON, DARK_CASE, RED_CRATE, WHITE_BOX)
    boxes = tuple(
        Box((1.4 + 0.6 * i, 0.5 - 0.33 * i), (0.25, 0.25, 0.3 + 0.08 * i), 0.0, texture)
        for i, texture in enumerate(textures)
    )
    path = Path(length=0.8, speed=0.3)
    return Scene("row", boxes, walls=_room(4.0, -4.0, -3.0, 8.0), floor=CARPET, path=path)


def _posts() -> Scene:
    posts = tuple(
        Cylinder((1.2 + 0.55 * i, 0.45 * (-1) ** i), 0.045, 0.8, POST, name="post")
        for i in range(5)
    )
    walls = _room(4.0, -4.0, -3.0, 8.0)
    return Scene("posts", (), posts, walls=walls, floor=WOOD, path=Path(length=0.6, yaw=pi / 60))


def _empty() -> Scene:
    return Scene("empty", walls=_room(4.5, -4.5, -3.0, 9.5), floor=TILES, path=Path(length=1.0))


_SCENES = {
    "demo": _demo,
    "drive": _drive,
    "empty": _empty,
    "single_box": _single_box,
    "row": _row,
    "posts": _posts,
}
SCENES = tuple(_SCENES)
"""Names of the fixed scenes: a room with eight obstacles, a drive of ten seconds past obstacles and
a walking person, an empty room, a box in front of a stationary robot, four boxes in a row, five
posts of 9 cm diameter."""


def load_scene(name: str, seed: int = 0, distance_m: float = 2.0) -> Scene:
    """Return a scene by its name, or from a file with the fields of :class:`Scene`.

    Args:
        name: One of ``SCENES`` or ``FAMILIES``, or a TOML or JSON file.
        seed: Random seed of a family.
        distance_m: Distance of the obstacle in ``cylinder`` and ``approach`` [m].

    Raises:
        ConfigError: There is no such scene, or the file has an unknown field or a wrong value.
        InputError: The file can't be read.
    """
    if name in _SCENES:
        return _SCENES[name]()
    if name in FAMILIES:
        return make_scene(name, seed, distance_m)
    if not name.endswith((".toml", ".json")):
        names = ", ".join([*SCENES, *FAMILIES])
        raise ConfigError(f"unknown scene {name!r}", remedy=f"use {names} or a TOML file")
    return read_scene(name)


def scene_of(config: SimConfig) -> Scene:
    """Return the scene of a configuration.

    Raises:
        ConfigError: The scene is unknown, or its file is wrong.
        InputError: The file can't be read.
    """
    scene = load_scene(config.scene, config.seed, config.distance_m)
    if config.slope_rad is not None:
        scene = replace(scene, ground=replace(scene.ground, slope_rad=config.slope_rad))
    return scene
