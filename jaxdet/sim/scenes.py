"""The scenes that come with the simulator, and reading others from TOML or JSON files."""

import json
import tomllib
from dataclasses import fields, is_dataclass
from math import pi
from pathlib import Path as FilePath
from typing import Any, get_args, get_type_hints

from jaxdet.errors import ConfigError, InputError
from jaxdet.sim.scene import Box, Cylinder, Path, Scene, Texture, Wall

TILES = Texture("tiles", color=(150, 146, 138), accent=(70, 68, 66), size_m=0.4, grain=3.0)
WOOD = Texture("wood", color=(172, 128, 84), accent=(84, 56, 34), size_m=0.14, grain=3.0)
CARPET = Texture("noise", color=(96, 108, 120), accent=(150, 158, 166), size_m=0.25, grain=5.0)
PLASTER = Texture("noise", color=(164, 160, 150), accent=(148, 144, 136), size_m=1.0, grain=1.5)
CARTON = Texture("carton", color=(226, 190, 140), accent=(92, 60, 34), size_m=0.35)
DARK_CASE = Texture("checker", color=(28, 30, 36), accent=(70, 74, 82), size_m=0.2, grain=4.0)
RED_CRATE = Texture("stripes", color=(150, 24, 28), accent=(40, 8, 12), size_m=0.12, grain=4.0)
BLUE_BIN = Texture("stripes", color=(24, 50, 128), accent=(226, 230, 236), size_m=0.3, grain=4.0)
POST = Texture("stripes", color=(238, 236, 230), accent=(176, 20, 22), size_m=0.24, grain=3.0)
BUCKET = Texture("stripes", color=(24, 90, 40), accent=(10, 36, 18), size_m=0.16, grain=4.0)
WHITE_BOX = Texture("carton", color=(238, 238, 236), accent=(40, 44, 60), size_m=0.4)


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
    return Scene("demo", boxes, cylinders, _room(3.4, -3.4, -3.0, 9.5), TILES, path=path)


def _single_box() -> Scene:
    box = Box((1.5, 0.0), (0.30, 0.40, 0.40), 0.0, CARTON, name="carton")
    walls = _room(4.0, -4.0, -3.0, 8.0)
    return Scene("single_box", (box,), (), walls, WOOD, path=Path(length=0.0))


def _row() -> Scene:
    looks = (CARTON, DARK_CASE, RED_CRATE, WHITE_BOX)
    boxes = tuple(
        Box((1.4 + 0.6 * i, 0.5 - 0.33 * i), (0.25, 0.25, 0.3 + 0.08 * i), 0.0, look)
        for i, look in enumerate(looks)
    )
    path = Path(length=0.8, speed=0.3)
    return Scene("row", boxes, (), _room(4.0, -4.0, -3.0, 8.0), CARPET, path=path)


def _posts() -> Scene:
    posts = tuple(
        Cylinder((1.2 + 0.55 * i, 0.45 * (-1) ** i), 0.045, 0.8, POST, name="post")
        for i in range(5)
    )
    walls = _room(4.0, -4.0, -3.0, 8.0)
    return Scene("posts", (), posts, walls, WOOD, path=Path(length=0.6, yaw=pi / 60))


def _empty() -> Scene:
    return Scene("empty", (), (), _room(4.5, -4.5, -3.0, 9.5), TILES, path=Path(length=1.0))


_SCENES = {"demo": _demo, "empty": _empty, "single_box": _single_box, "row": _row, "posts": _posts}
SCENES = tuple(_SCENES)
"""Names of the scenes: a room with eight obstacles, an empty room, one box seen from a standing
robot, four boxes in a row, five posts of 9 cm diameter."""


def load_scene(name: str) -> Scene:
    """A scene by its name, or from a TOML or JSON file with the fields of :class:`Scene`.

    Raises:
        ConfigError: There is no such scene, or the file has an unknown field or a wrong value.
        InputError: The file can't be read.
    """
    if name in _SCENES:
        return _SCENES[name]()
    path = FilePath(name)
    if path.suffix not in (".toml", ".json"):
        raise ConfigError(f"no scene {name!r}", remedy=f"use {', '.join(SCENES)} or a TOML file")
    try:
        text = path.read_text(encoding="utf-8")
        data = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except (OSError, ValueError) as error:
        raise InputError(f"no scene can be read: {error}", path=name) from error
    return _build(Scene, data, name)


def _build(kind: Any, data: Any, where: str) -> Any:
    """Turn parsed TOML into the dataclass or tuple that ``kind`` says."""
    if isinstance(kind, type) and is_dataclass(kind) and isinstance(data, dict):
        hints = get_type_hints(kind)
        unknown = sorted(set(data) - {f.name for f in fields(kind)})
        if unknown:
            raise ConfigError(f"unknown field {unknown[0]!r}", path=where, remedy="see jaxdet.sim")
        values = {k: _build(hints[k], v, f"{where}: {k}") for k, v in data.items()}
        try:
            return kind(**values)
        except TypeError as error:
            raise ConfigError(str(error), path=where) from error
    if isinstance(data, list):
        return tuple(_build(get_args(kind)[0], item, where) for item in data)
    if isinstance(data, dict) or is_dataclass(kind):
        raise ConfigError("a table and a value are mixed up", path=where)
    return data
