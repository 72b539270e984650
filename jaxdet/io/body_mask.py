"""Masks of what a camera sees of its own robot.

A mask is an image as large as the depth images. Depth counts as not measured where it is black.
:class:`jaxdet.io.options.LogOptions` holds its pixels as text, so that results hold all that they
were made with: ``WIDTHxHEIGHT:``, then lengths of runs of pixels, row by row, by turns white and
black, white first.
"""

import re
from itertools import accumulate
from pathlib import Path

import numpy as np

from jaxdet.errors import ConfigError, InputError

FLAG = "--log.mask"
MAX_PIXELS = 1 << 25
_MAX_BYTES = 64 << 20
_AS_TEXT = re.compile(r"(\d{1,5})x(\d{1,5}):(\d{1,8}(?: \d{1,8})*)")


def masks_text(given: str) -> str:
    """Return masks as text, their files read.

    Args:
        given: ``FILE``, or ``CAMERA=FILE`` for each camera, separated by commas; text in place of
            a file stays.

    Raises:
        ConfigError: A file is missing or not a PNG, a camera is named twice, or text is invalid.
    """
    masks: dict[str, str] = {}
    for item in given.split(","):
        camera, equals, source = (part.strip() for part in item.rpartition("="))
        if camera in masks:
            problem = f"{FLAG} has two masks of {camera or 'every camera'}"
            raise ConfigError(problem, remedy="give CAMERA=FILE once for each camera")
        if _AS_TEXT.fullmatch(source):
            _hidden(source)
        else:
            source = as_text(_read(Path(source)))
        masks[camera] = f"{camera}{equals}{source}"
    return ",".join(masks.values())


def hidden_pixels(
    masks: str | None, camera: str, names: tuple[str, ...], size: tuple[int, int], path: str
) -> np.ndarray | None:
    """Return the pixels of a camera's depth images that show its own robot.

    Args:
        masks: Text of :func:`masks_text`; None: there is no mask.
        camera: Name of the camera.
        names: Names of all cameras of the log.
        size: Width and height of the depth images.
        path: The log, for errors.

    Returns:
        ``(H, W)`` bool, true where it does; None without a mask of this camera.

    Raises:
        InputError: A mask is of a camera that the log hasn't, or of another size.
    """
    if masks is None:
        return None
    found = {}
    for item in masks.split(","):
        name, _, text = item.rpartition("=")
        if name and name not in names:
            remedy = f"cameras of this log: {', '.join(names)}"
            raise InputError(f"{FLAG}: no camera {name!r}", path=path, remedy=remedy)
        found[name] = text
    text = found.get(camera, found.get(""))
    if text is None:
        return None
    hidden = _hidden(text)
    if hidden.shape != size[::-1]:
        sizes = f"{hidden.shape[1]}x{hidden.shape[0]}, its depth images {size[0]}x{size[1]}"
        remedy = "draw it on a depth image, or give CAMERA=FILE for each camera"
        raise InputError(f"{FLAG}: the mask of {camera} is {sizes}", path=path, remedy=remedy)
    return hidden


def as_text(hidden: np.ndarray) -> str:
    """Return a mask ``(H, W)`` bool, true where it is black, as text."""
    flat = hidden.ravel()
    ends = [*(np.flatnonzero(np.diff(flat)) + 1).tolist(), flat.size]
    starts = [0, *ends[:-1]]
    runs = [end - start for start, end in zip(starts, ends, strict=True)]
    runs = [0, *runs] if flat[0] else runs
    return f"{hidden.shape[1]}x{hidden.shape[0]}:{' '.join(map(str, runs))}"


def _hidden(text: str) -> np.ndarray:
    """Return the mask ``(H, W)`` bool of text, true where it is black."""
    match = _AS_TEXT.fullmatch(text)
    width, height = (int(match[1]), int(match[2])) if match else (0, 0)
    runs = [int(run) for run in match[3].split(" ")] if match else []
    if not 0 < width * height <= MAX_PIXELS or sum(runs) != width * height:
        raise ConfigError(f"{FLAG} is not a mask: {text[:40]!r}", remedy="give a PNG file")
    flat = np.zeros(width * height, bool)
    ends = list(accumulate(runs))
    for start, end in zip(ends[::2], ends[1::2], strict=False):
        flat[start:end] = True
    return flat.reshape(height, width)


def _read(path: Path) -> np.ndarray:
    """Return the mask ``(H, W)`` bool of a PNG file, true where it is black."""
    import cv2

    from jaxdet.io.png import read_png_head

    try:
        if not path.is_file():
            problem = "no such mask" if not path.exists() else "is not a file"
            raise ConfigError(problem, path=str(path), topic=FLAG)
        data = path.read_bytes() if path.stat().st_size <= _MAX_BYTES else b""
        head = read_png_head(data)
    except (OSError, ValueError) as error:
        problem = f"can't be read ({getattr(error, 'strerror', None) or error})"
        raise ConfigError(problem, path=str(path), topic=FLAG, remedy="give a PNG file") from error
    image = None
    if 0 < head.width * head.height <= MAX_PIXELS:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        problem = f"PNG of {head.width}x{head.height} pixels can't be decoded"
        raise ConfigError(problem, path=str(path), topic=FLAG, remedy="save it again")
    return image.reshape(*image.shape[:2], -1)[..., :3].max(axis=-1) == 0
