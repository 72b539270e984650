"""RGB-D stills of public repositories: recipes, decoding, and pictures for labelling."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from jaxdet.errors import InputError

LABELS = Path(__file__).with_name("labels")
ROOMS = LABELS / "rooms.json"
PUBLIC = tuple(LABELS / f"public{n}.json" for n in ("", 2, 3, 4, 5))
"""Recipes, a dictionary per recording; the public ones have ``place`` and ``split``."""
SUN_TURN = 3
"""Number of bits by which SUN RGB-D rotates its depths."""
NIVIEWER_BYTES = 24
"""Size of the header of a frame that NiViewer has saved: format, width, height, and others."""
TICK, PICTURE_HEIGHT, MARGIN = 50, 480, 24


def read_recipe(path: Path) -> list[dict[str, Any]]:
    """Return the recordings of a recipe."""
    return json.loads(path.read_text(encoding="utf-8"))


def clone_of(room: dict[str, Any], clones: Path) -> Path | None:
    """Return the clone of a recording's repository, ``owner+name`` or ``name``, if any."""
    owner, name = room["repository"].split("/")
    return next((p for p in (clones / f"{owner}+{name}", clones / name) if p.is_dir()), None)


def read_color(path: Path, size: tuple[int, int] | None = None) -> np.ndarray:
    """Read a colour image ``(H, W, 3)`` uint8, RGB, and resize it to ``size`` (width, height).

    Raises:
        InputError: The image can't be read.
    """
    if path.suffix == ".npy":
        image = np.load(path)
    elif path.suffix == ".raw":
        image = _read_raw(path, np.uint8, 3)[..., ::-1]
    else:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise InputError("no image can be read", path=str(path))
    if size is not None and image.shape[1::-1] != tuple(size):
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(image[..., ::-1])


def read_depth(path: Path, unit_m: float, coding: str = "") -> np.ndarray:
    """Read a depth image ``(H, W)`` uint16 [mm]; 0 means no measurement.

    Args:
        path: Path of an image, of an array ``(H, W)`` or ``(H, W, 1)`` in a ``.npy`` file, of a
            ``.mat`` file, or of a ``.raw`` file.
        unit_m: Unit of its values [m].
        coding: ``sunrgbd`` if its bits are rotated as in SUN RGB-D.

    Raises:
        InputError: The image can't be read.
    """
    if path.suffix == ".mat":
        from scipy.io import loadmat

        image = loadmat(path)["depth_array"]
    elif path.suffix == ".raw":
        image = _read_raw(path, np.uint16, 1)[..., 0]
    elif path.suffix == ".npy":
        image = np.load(path)
        if image.shape[2:] == (1,):
            image = image[..., 0]
    else:
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 2:
        raise InputError("no depth image can be read", path=str(path))
    if coding == "sunrgbd":
        turned = np.asarray(image, np.uint16)
        image = np.right_shift(turned, SUN_TURN) | np.left_shift(turned, 16 - SUN_TURN)
    millimetres = np.nan_to_num(image * (unit_m / 0.001), posinf=0, neginf=0)
    return np.clip(np.rint(millimetres), 0, 65535).astype(np.uint16)


def _read_raw(path: Path, dtype: type, channels: int) -> np.ndarray:
    """Return a frame that NiViewer has saved, ``(H, W, channels)``.

    Raises:
        InputError: The size in its header is not that of the file.
    """
    data = path.read_bytes()
    width, height = np.frombuffer(data[4:12].ljust(8, b"\0"), np.uint32).tolist()
    values = np.frombuffer(data[NIVIEWER_BYTES:], dtype)
    if not values.size or values.size != width * height * channels:
        raise InputError("no frame of NiViewer", path=str(path))
    return values.reshape(height, width, channels)


def frame_id(room: dict[str, Any], number: int) -> str:
    """Return the name of a frame: the name of its recording and its number there."""
    return f"{room['name']}_{number}"


def picture(color: np.ndarray, depth_mm: np.ndarray) -> np.ndarray:
    """Return colour and depth side by side in BGR, with axes in pixels of the colour image.

    Near depths are red, far ones blue; pixels without depth are black.

    Args:
        color: Image ``(H, W, 3)`` uint8, RGB.
        depth_mm: Depth image ``(h, w)`` uint16 of the same view [mm].
    """
    seen = depth_mm > 0
    near, far = np.percentile(depth_mm[seen], [1, 97]) if seen.any() else (0, 1)
    warm = np.clip((far - depth_mm.astype(float)) / max(far - near, 1), 0, 1)
    mapped = cv2.applyColorMap((warm * 255).astype(np.uint8), cv2.COLORMAP_TURBO)
    mapped[~seen] = 0
    height, width = color.shape[:2]
    shown = PICTURE_HEIGHT
    size = round(width * shown / height), shown
    views = []
    for image in (color[..., ::-1], mapped):
        way = cv2.INTER_AREA if image.shape[0] > shown else cv2.INTER_NEAREST
        view = cv2.resize(np.ascontiguousarray(image), size, interpolation=way)
        view = cv2.copyMakeBorder(view, 0, MARGIN, MARGIN + 8, 4, cv2.BORDER_CONSTANT)
        views.append(_axes(view, shown / height, width, height))
    return np.hstack(views)


def _axes(view: np.ndarray, scale: float, width: int, height: int) -> np.ndarray:
    """Draw a dot every :data:`TICK` pixels of the colour image, and coordinates at the margins."""
    left, bottom = MARGIN + 8, view.shape[0] - MARGIN
    for u in range(0, width, TICK):
        x = left + round(u * scale)
        _text(view, f"{u}", (x - 8, bottom + 16))
        cv2.line(view, (x, bottom), (x, bottom + 4), (255, 255, 255), 1)
        for v in range(0, height, TICK):
            cv2.circle(view, (x, round(v * scale)), 1, (255, 255, 255), -1)
            cv2.circle(view, (x, round(v * scale)), 2, (0, 0, 0), 1)
    for v in range(0, height, TICK):
        y = round(v * scale)
        _text(view, f"{v}", (0, min(y + 8, bottom)))
        cv2.line(view, (left - 4, y), (left, y), (255, 255, 255), 1)
    return view


def _text(view: np.ndarray, text: str, place: tuple[int, int]) -> None:
    cv2.putText(view, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.36, (255, 255, 255), 1, cv2.LINE_AA)
