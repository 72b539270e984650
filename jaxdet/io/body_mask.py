"""Masks of the robot's own body in the depth image.

A mask is an image of the size of the depth images, whose black pixels show the robot, or polygons
around the robot; depth there counts as unmeasured.
:class:`jaxdet.io.options.LogOptions` stores the mask as text, so that results contain all of their
inputs: ``WIDTHxHEIGHT:``, then the lengths of alternating runs of white and black pixels in
row order, starting with white.
"""

import json
import os
import re
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from jaxdet.errors import ConfigError, InputError

FLAG = "--log.mask"
MAX_PIXELS = 1 << 25
_MAX_BYTES = 64 << 20
_FARTHEST = 1e6
"""Maximum coordinate of a point of a polygon [pixel]; others are moved there."""
_MUCH = 0.5
"""Fraction of masked pixels above which black and white may be confused."""
_FORMS = "pass a PNG, or JSON with polygons as in jaxdet help calibration"
_RULE = "the robot must be black and all else white, or inside the polygons"
_NEXT_CAMERA = re.compile(",(?=[^,=]*=)")
_AS_TEXT = re.compile(r"(\d{1,5})x(\d{1,5}):(\d{1,8}(?: \d{1,8})*)")


def masks_text(given: str) -> str:
    """Read the files of masks; return the masks as text.

    Args:
        given: ``FILE``, or ``CAMERA=FILE`` per camera, separated by commas. The names of files may
            contain both characters. A mask that is text instead of a file is returned unchanged.

    Raises:
        ConfigError: A file is missing or has no mask, a camera occurs twice, or a text is invalid.
    """
    masks: dict[str, str] = {}
    for item in [f"={given}"] if os.path.isfile(given) else _NEXT_CAMERA.split(given):
        camera, source = item.split("=", 1) if "=" in item else ("", item)
        camera, source = camera.strip(), source.strip()
        if camera in masks:
            problem = f"{FLAG}: two masks for {camera or 'every camera'}"
            raise ConfigError(problem, remedy="pass CAMERA=FILE once per camera")
        if _AS_TEXT.fullmatch(source):
            _hidden(source)
        else:
            source = as_text(_read(Path(source)))
        masks[camera] = f"{camera}={source}" if camera else source
    return ",".join(masks.values())


def hidden_pixels(
    masks: str | None, camera: str, names: tuple[str, ...], size: tuple[int, int], path: str
) -> np.ndarray | None:
    """Return the pixels of a camera's depth images that show the robot's own body.

    Args:
        masks: Text from :func:`masks_text`; None: no mask.
        camera: Name of the camera.
        names: Names of all cameras of the log.
        size: Width and height of the depth images.
        path: Path of the log, for errors.

    Returns:
        Mask ``(H, W)`` bool, True on the robot's body; None if this camera has no mask.

    Raises:
        InputError: A mask is for a camera that is not in the log, has another size, or covers
            everything.
    """
    if masks is None:
        return None
    found = {}
    for item in masks.split(","):
        name, _, text = item.rpartition("=")
        if name and name not in names:
            remedy = f"cameras of this log: {', '.join(names)}"
            raise InputError(f"{FLAG}: unknown camera {name!r}", path=path, remedy=remedy)
        found[name] = text
    text = found.get(camera, found.get(""))
    if text is None:
        return None
    hidden = _hidden(text)
    if hidden.shape != size[::-1]:
        sizes = f"{hidden.shape[1]}x{hidden.shape[0]}, but its depth images are {size[0]}x{size[1]}"
        remedy = "draw it on a depth image, or pass CAMERA=FILE per camera"
        raise InputError(f"{FLAG}: the mask of {camera} is {sizes}", path=path, remedy=remedy)
    if hidden.all():
        raise InputError(f"{FLAG}: the mask of {camera} covers all pixels", path=path, remedy=_RULE)
    return hidden


def mask_doubts(hidden: np.ndarray | None) -> list[str]:
    """Return a warning if a mask covers nothing or most of the images, else no warning."""
    if hidden is None or 0 < (share := hidden.mean()) <= _MUCH:
        return []
    covered = f"{100 * share:.0f} % of the depth image" if share else "no pixel: it has no effect"
    return [f"{FLAG} covers {covered}; {_RULE}"]


def as_text(hidden: np.ndarray) -> str:
    """Encode a mask ``(H, W)`` bool, True for black pixels, as text."""
    flat = hidden.ravel()
    ends = [*(np.flatnonzero(np.diff(flat)) + 1).tolist(), flat.size]
    starts = [0, *ends[:-1]]
    runs = [end - start for start, end in zip(starts, ends, strict=True)]
    runs = [0, *runs] if flat[0] else runs
    return f"{hidden.shape[1]}x{hidden.shape[0]}:{' '.join(map(str, runs))}"


def _hidden(text: str) -> np.ndarray:
    """Decode a mask ``(H, W)`` bool, True for black pixels, from text."""
    match = _AS_TEXT.fullmatch(text)
    width, height = (int(match[1]), int(match[2])) if match else (0, 0)
    runs = [int(run) for run in match[3].split(" ")] if match else []
    if not 0 < width * height <= MAX_PIXELS or sum(runs) != width * height:
        raise ConfigError(f"{FLAG}: invalid mask {text[:40]!r}", remedy="pass a PNG file")
    flat = np.zeros(width * height, bool)
    ends = list(accumulate(runs))
    for start, end in zip(ends[::2], ends[1::2], strict=False):
        flat[start:end] = True
    return flat.reshape(height, width)


def _read(path: Path) -> np.ndarray:
    """Read a mask ``(H, W)`` bool, True on the robot, from a PNG file or polygons in JSON."""
    try:
        if not os.path.isfile(path):
            problem = "is not a file" if os.path.exists(path) else "no such file"
            remedy = "check the path; several masks are CAMERA=FILE,CAMERA=FILE"
            raise ConfigError(problem, path=str(path), topic=FLAG, remedy=remedy)
        if path.stat().st_size > _MAX_BYTES:
            raise ValueError(f"it has more than {_MAX_BYTES >> 20} MiB")
        data = path.read_bytes()
        return _inside(json.loads(data)) if path.suffix.lower() == ".json" else _black(data)
    except (OSError, ValueError, ArithmeticError, TypeError, KeyError, RecursionError) as error:
        problem = f"can't be read as a mask ({getattr(error, 'strerror', None) or error})"
        raise ConfigError(problem, path=str(path), topic=FLAG, remedy=_FORMS) from error


def _black(data: bytes) -> np.ndarray:
    """Return the black pixels ``(H, W)`` bool of a PNG file."""
    import cv2

    from jaxdet.io.png import read_png_head

    head, image = read_png_head(data), None
    if 0 < head.width * head.height <= MAX_PIXELS:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError(f"the PNG of {head.width}x{head.height} pixels can't be decoded")
    return image.reshape(*image.shape[:2], -1)[..., :3].max(axis=-1) == 0


def _inside(content: Any) -> np.ndarray:
    """Return the pixels ``(H, W)`` bool inside polygons in jaxdet's format, labelme's or COCO's."""
    import cv2

    match content:
        case {"width": width, "height": height, "polygons": polygons}:
            pass
        case {"imageWidth": width, "imageHeight": height, "shapes": shapes}:
            polygons = [_outline(one["points"], one.get("shape_type")) for one in shapes]
        case {"images": [{"width": width, "height": height}], "annotations": parts}:
            rings = [ring for part in parts for ring in part["segmentation"]]
            polygons = [list(zip(ring[::2], ring[1::2], strict=True)) for ring in rings]
        case _:
            raise ValueError("it has no polygons of one image with width and height")
    if not 0 < width * height <= MAX_PIXELS or not isinstance(width * height, int):
        raise ValueError(f"the image has {width}x{height} pixels")
    image = np.zeros((height, width), np.uint8)
    for polygon in polygons:
        points = np.asarray(polygon, np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3 or np.isnan(points).any():
            raise ValueError("a polygon is not a list of three or more points [x, y]")
        nearest = np.rint(points.clip(-_FARTHEST, _FARTHEST)).astype(np.int32)
        cv2.fillPoly(image, [nearest], 1)
    return image > 0


def _outline(points: Any, kind: str | None) -> Any:
    """Return the polygon of a shape of labelme."""
    if kind == "rectangle":
        (left, top), (right, bottom) = points
        return [(left, top), (right, top), (right, bottom), (left, bottom)]
    if kind not in ("polygon", None):
        raise ValueError(f"the shape {kind} is neither a polygon nor a rectangle")
    return points
