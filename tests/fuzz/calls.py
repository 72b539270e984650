"""Calls of every public name with randomly changed arguments.

Each call succeeds, or raises an error of one line that names an argument.
"""

import dataclasses
import re
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from enum import Enum
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxdet
from jaxdet.errors import JaxdetError
from jaxdet.results import metric
from tests.fuzz.calibrations import MODELS, ODD
from tests.fuzz.case import Case, Verdict, ended
from tests.io_helpers import make_scene, write_log
from tests.scenes import blocks, frames, level, small, smooth_depth

FRAMES = 2
CALIBRATION = small(96, 60)
COLOR, DEPTH = blocks(FRAMES, 60, 96), smooth_depth(FRAMES, CALIBRATION.depth)
GOOD = frames(CALIBRATION, COLOR, DEPTH, plane=level(FRAMES))._replace(
    T_world_camera=np.tile(np.eye(4), (FRAMES, 1, 1))
)
MOTION = CALIBRATION.color_from_depth.T
CAMERA = CALIBRATION.depth
DETECTOR = {"K": CAMERA.K, "color_K": CALIBRATION.color, "T_color_depth": MOTION}
SETTINGS = {"depth_unit_m": 0.001, "color_order": "rgb", "mount": jaxdet.Mount(0.4)}
BACKENDS = "jax", "jax", "reference"
MOST_BYTES = 1 << 30
"""Number of rows of a broadcast array, which uses little memory unless a call copies it."""


class Raises:
    """Object whose conversions to an array and to text raise errors."""

    def __array__(self, *_: Any, **__: Any) -> np.ndarray:
        raise RuntimeError("no array\nat all")

    def __len__(self) -> int:
        raise RuntimeError("no length")

    def __str__(self) -> str:
        raise RuntimeError("no text")

    __repr__ = __str__


class Lies:
    """Object whose ``shape`` and ``dtype`` differ from those of the array it converts to."""

    def __init__(self, like: Any) -> None:
        self.shape, self.dtype = np.shape(like), np.asarray(like).dtype
        self.ndim = len(self.shape)

    def __len__(self) -> int:
        return self.shape[0] if self.shape else 0

    def __array__(self, *_: Any, **__: Any) -> np.ndarray:
        return np.zeros((3, 5), np.complex64)


class Text(str):
    """Subclass of ``str``."""


def _arrays(value: np.ndarray, random: Random) -> Iterator[Any]:
    """Yield functions that return invalid or unusual forms of an array."""
    kinds = "?", "b", "B", "h", "H", "i", "q", "Q", "e", "f", "d", "D", "U3", "O", "M8[s]", ">u2"
    with np.errstate(all="ignore"):
        yield lambda: value.astype(random.choice(kinds))
    yield lambda: value[:0]
    yield lambda: value[..., :0]
    yield lambda: value[:1]
    yield lambda: value[..., :-1]
    yield lambda: value[None]
    yield lambda: value.ravel()
    yield lambda: value[0]
    yield lambda: value.T
    yield lambda: value[::-1]
    yield lambda: np.repeat(value, 2, axis=-1)[..., ::2]
    yield lambda: np.asfortranarray(value)
    yield lambda: np.lib.stride_tricks.as_strided(value, writeable=False)
    yield (
        lambda: (
            np.frombuffer(b"\1" + value.tobytes(), np.uint8)[1:]
            .view(value.dtype)
            .reshape(value.shape)
        )
    )
    yield lambda: np.ma.masked_equal(value, 0)
    yield lambda: np.broadcast_to(value.ravel()[0], value.shape)
    yield lambda: np.broadcast_to(value.ravel()[:1], (MOST_BYTES, *value.shape[1:-1], 1))
    yield lambda: np.broadcast_to(
        np.zeros(1, value.dtype), (1 << 20, *(1 << 10,) * (value.ndim - 1))
    )
    yield lambda: value.tolist()
    yield lambda: memoryview(np.ascontiguousarray(value))
    yield lambda: jnp.asarray(value.astype(np.float32) if value.dtype == np.float64 else value)
    yield lambda: jax.ShapeDtypeStruct(value.shape, value.dtype)
    yield lambda: [*value[:1], None]
    yield lambda: [value[0], value[0][..., :1]]
    yield lambda: Lies(value)
    yield lambda: _poisoned(value, random)
    yield lambda: _poisoned(value, random)


def _poisoned(value: np.ndarray, random: Random) -> np.ndarray:
    """Return the array with some entries replaced by numbers from ``ODD``."""
    found = np.array(value, np.float64 if value.dtype != np.uint8 else None)
    with np.errstate(all="ignore"):
        for _ in range(random.choice((1, 1, 3, found.size))):
            number = random.choice(ODD) * random.choice((1, -1))
            odd = np.array([number]).astype(found.dtype)[0]
            found[tuple(random.randrange(size) for size in found.shape)] = odd
        return found.astype(value.dtype) if random.random() < 0.6 else found


_ANYTHING: tuple[Any, ...] = (
    None, True, -1, 0, 1, 3, 1 << 40, 1 << 70, 0.5, 1j, "", "x", "../x\n\x1b[31m", "\0", b"x",
    Text("jax"), (), [], {}, [[]], {"x": 1}, object(), Raises(), int, len, np.zeros(0), range(3),
    np.zeros((2, 2), object), np.float32(np.nan), np.datetime64("now", "s"), float("nan"),
    float("-inf"), [1] * 99,
)  # fmt: skip


def _mutated(value: Any, random: Random) -> tuple[Any, str]:
    """Return a changed value, and the path of the part that was changed."""
    if random.random() < 0.25:
        return random.choice(_ANYTHING), ""
    if fields := getattr(value, "_fields", ()):
        name = random.choice(fields)
        part, where = _mutated(getattr(value, name), random)
        return value._replace(**{name: part}), f".{name}{where}"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        name = random.choice([field.name for field in dataclasses.fields(value)])
        part, where = _mutated(getattr(value, name), random)
        return dataclasses.replace(value, **{name: part}), f".{name}{where}"
    if isinstance(value, np.ndarray) and 0 < value.nbytes < 1 << 24:
        with suppress(TypeError, ValueError, IndexError, OverflowError), np.errstate(all="ignore"):
            return random.choice(list(_arrays(value, random)))(), ""
        return None, ""
    if isinstance(value, Mapping) and value:
        name = random.choice(list(value))
        part, where = _mutated(value[name], random)
        return {**value, name: part}, f"[{name}]{where}"
    if isinstance(value, bool):
        return random.choice(_ANYTHING), ""
    if isinstance(value, int | float):
        return random.choice(ODD) * random.choice((1, -1)), ""
    if isinstance(value, str) and not isinstance(value, Enum):
        return random.choice((*map(str, MODELS), value + "x", value.upper(), Text(value))), ""
    return random.choice(_ANYTHING), ""


def _detector(random: Random, **changed: Any) -> jaxdet.Detector:
    return jaxdet.Detector(
        **{**DETECTOR, **SETTINGS, "backend": random.choice(BACKENDS), **changed}
    )


class Calls:
    """Call public names.

    Args:
        folder: Folder for a log.
    """

    def __init__(self, folder: Path) -> None:
        self._path = write_log(folder / "x.mcap", make_scene(3))
        self._other = folder / "nothing.txt"
        self._other.write_text("nothing", encoding="utf-8")
        self._log = jaxdet.open_log(self._path)
        self._found = jaxdet.detect(GOOD, backend="reference", with_cells=True)
        self._calls = self._table()
        for backend in ("jax", "reference"):
            _detector(Random(0), backend=backend)(DEPTH[0], COLOR[0])
            list(jaxdet.Detector.from_log(self._log, backend=backend).run(self._log, 2))
            jaxdet.estimate_plane(GOOD, backend=backend)

    def _table(self) -> dict[str, tuple[Callable[..., Any], dict[str, Any]]]:
        """Return, by name, each function with valid arguments."""
        obstacles, config = self._found.obstacles, jaxdet.Config()
        own = jaxdet.Detector.from_log(self._log, backend="reference")
        corners = metric.rectangles(obstacles, 0.001, config.footprint)
        options = {"config": config, "backend": "jax"}
        result = _detector(Random(0), backend="reference")(DEPTH[0], COLOR[0])
        batch = _detector(Random(0), backend="reference").batch(DEPTH, COLOR)
        dataclass_calls = {
            kind.__name__: (kind, {f.name: getattr(good, f.name) for f in dataclasses.fields(good)})
            for good in (
                jaxdet.Mount(0.4, 0.1, 0.2),
                config,
                jaxdet.LogOptions(),
                *vars(config).values(),
            )
            for kind in (type(good),)
        }
        tuples = {
            type(good).__name__: (
                lambda g=good, **more: jaxdet.detect(_put(g, more)),
                good._asdict(),
            )
            for good in (CAMERA, CALIBRATION, CALIBRATION.color_from_depth, GOOD.plane, GOOD)
        }
        plain = dict(
            zip(
                ("depth", "color", "stamp_ns", "T_world_camera"),
                (DEPTH[0], COLOR[0], 5, np.eye(4)),
                strict=True,
            )
        )
        many = {
            "depth": DEPTH,
            "color": COLOR,
            "stamps_ns": np.arange(2),
            "T_world_camera": GOOD.T_world_camera,
        }
        return {
            "detect": (jaxdet.detect, {"frames": GOOD, **options, "with_cells": False}),
            "find_floors": (jaxdet.find_floors, {"frames": GOOD, **options}),
            "estimate_plane": (jaxdet.estimate_plane, {"frames": GOOD, **options}),
            **{
                f"{how.__name__}(detect)": (partial(_transformed, how), {"frames": GOOD})
                for how in (jax.jit, jax.vmap)
            },
            "Detector": (
                lambda **more: _detector(Random(0), **more),
                {**DETECTOR, **SETTINGS, "config": config, "backend": "jax"},
            ),
            "Detector()": (
                _detector(Random(0), backend="jax"),
                {**plain, "mount": jaxdet.Mount(0.4)},
            ),
            "Detector.batch": (
                _detector(Random(0), backend="jax").batch,
                {**many, "mounts": [jaxdet.Mount(0.4)] * 2},
            ),
            "Detector.from_log": (jaxdet.Detector.from_log, {"log": self._log, **options}),
            "Detector.run": (
                lambda **more: list(own.run(**more)),
                {"log": self._log, "batch_size": 2, "color": True},
            ),
            "FrameResult.draw": (result.draw, {"color": COLOR[0]}),
            "FrameResult[]": (lambda index: result[index], {"index": 0}),
            "BatchResult[]": (lambda index: batch[index], {"index": 0}),
            "extents": (jaxdet.extents, {"obstacles": obstacles, "depth_unit": 0.001}),
            "rectangles": (
                jaxdet.rectangles,
                {"obstacles": obstacles, "depth_unit": 0.001, "config": config.footprint},
            ),
            "to_world": (
                jaxdet.to_world,
                {"corners": corners, "T_world_camera": GOOD.T_world_camera},
            ),
            "flat_plane": (jaxdet.flat_plane, {"height": 0.4, "pitch": 0.1, "roll": 0.0}),
            "preset": (jaxdet.preset, {"name": "wheeled"}),
            "find_logs": (jaxdet.find_logs, {"inputs": [str(self._path)]}),
            "open_log": (
                lambda **more: jaxdet.open_log(**more).close(),
                {"source": str(self._path), "options": jaxdet.LogOptions()},
            ),
            "Log.batches": (
                lambda **more: list(self._log.batches(**more)),
                {"batch_size": 2, "start": 0, "stop": 3, "color": True},
            ),
            "Log.read": (self._log.read, {"indices": [0, 1]}),
            "Log[]": (lambda index: self._log[index], {"index": 1}),
            "Intrinsics.from_matrix": (
                jaxdet.Intrinsics.from_matrix,
                {
                    "K": CAMERA.K,
                    "width": 96,
                    "height": 60,
                    "distortion": np.zeros(5),
                    "model": "plumb_bob",
                },
            ),
            "Extrinsics.from_matrix": (jaxdet.Extrinsics.from_matrix, {"T": MOTION}),
            "Mount.from_gravity": (
                jaxdet.Mount.from_gravity,
                {"height_m": 0.4, "gravity": np.array([0.0, 9.8, 1.0])},
            ),
            "Mount.from_transform": (jaxdet.Mount.from_transform, {"T_base_camera": _base()}),
            **dataclass_calls,
            **tuples,
        }

    def one(self, seed: int) -> Case:
        """Make the call of a seed."""
        random = Random(seed)
        name = random.choice(list(self._calls))
        function, good = self._calls[name]
        given, where = dict(good), []
        for _ in range(random.choice((1, 1, 1, 2))):
            argument = random.choice(list(given))
            try:
                given[argument], part = _mutated(given[argument], random)
            except (JaxdetError, TypeError, ValueError) as error:  # raised by a constructor
                return Case(f"{name} seed {seed}", _named(error, {argument, "config"}), {})
            where.append(f"{argument}{part}")
        title = f"{name} {'+'.join(where)} seed {seed}"
        words = {word for text in where for word in re.findall(r"\w+", text)} | {*good}
        return Case(title, ended(lambda: _call(function, given, words)), {})


def _base() -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[2, 3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], 0.7
    return T


def _transformed(how: Callable[..., Any], frames: Any) -> Any:
    """Call ``detect`` under a transformation of JAX."""
    depth = getattr(frames, "depth", None)
    plain = isinstance(depth, np.ndarray | jax.Array) and depth.dtype.kind in "biuf"
    if not plain or isinstance(depth, np.ma.MaskedArray):
        return jaxdet.detect(frames)  # JAX itself refuses to trace other arrays
    return how(lambda depth: jaxdet.detect(frames._replace(depth=depth)))(depth)


def _put(part: Any, more: dict[str, Any]) -> Any:
    """Return valid frames in which a part is replaced by its changed copy."""
    made = type(part)(**more)
    if isinstance(part, jaxdet.Frames):
        return made
    if isinstance(part, jaxdet.GroundPlane):
        return GOOD._replace(plane=made)
    whole = CALIBRATION
    if isinstance(part, jaxdet.Intrinsics):
        whole = whole._replace(depth=made)
    elif isinstance(part, jaxdet.Extrinsics):
        whole = whole._replace(color_from_depth=made)
    else:
        whole = made
    return GOOD._replace(calibration=whole)


def _call(function: Callable[..., Any], given: dict[str, Any], words: set[str]) -> Verdict:
    try:
        with np.errstate(all="ignore"):
            found = function(**given)
            jax.block_until_ready(
                [part for part in jax.tree.leaves(found) if hasattr(part, "shape")]
            )
    except (JaxdetError, TypeError, ValueError, IndexError) as error:
        return _named(error, words)
    return Verdict("clean")


_OF_PYTHON = re.compile(
    r"argument|ind(ex|ices) must be|not a valid|frames? \[?-?[0-9]+\]? of|out of range|an integer"
)
"""Pattern of errors that Python itself raises for calls, sequences and enumerations."""


def _named(error: Exception, words: set[str]) -> Verdict:
    """Judge whether an error is one line that names an argument."""
    text = str(error)
    if isinstance(error, JaxdetError):
        return Verdict("error" if text and text.isprintable() else "bad message", text)
    named = set(re.findall(r"\w+", text)) & words
    if text.isprintable() and (named or _OF_PYTHON.search(text)):
        return Verdict("error", text)
    return Verdict("bad message", "".join(traceback.format_exception(error)[-6:]))
