"""Masks of the robot's own body in the depth image.

A mask is an image of the size of the depth images; depth under black pixels counts as unmeasured.
:class:`jaxdet.io.options.LogOptions` stores the mask as text, so that results contain all of their
inputs: ``WIDTHxHEIGHT:``, then the lengths of alternating runs of white and black pixels in
row order, starting with white.
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
    """Read the files of masks; return the masks as text.

    Args:
        given: ``FILE``, or ``CAMERA=FILE`` per camera, separated by commas. A mask that is text
            instead of a file is returned unchanged.

    Raises:
        ConfigError: A file is missing or not a PNG, a camera occurs twice, or a text is invalid.
    """
    masks: dict[str, str] = {}
    for item in given.split(","):
        camera, equals, source = (part.strip() for part in item.rpartition("="))
        if camera in masks:
            problem = f"{FLAG}: two masks for {camera or 'every camera'}"
            raise ConfigError(problem, remedy="pass CAMERA=FILE once per camera")
        if _AS_TEXT.fullmatch(source):
            _hidden(source)
        else:
            source = as_text(_read(Path(source)))
        masks[camera] = f"{camera}{equals}{source}"
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
        InputError: A mask is for a camera that is not in the log, or has another size.
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
    return hidden


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
    """Read a mask ``(H, W)`` bool, True for black pixels, from a PNG file."""
    import cv2

    from jaxdet.io.png import read_png_head

    try:
        if not path.is_file():
            problem = "no such file" if not path.exists() else "is not a file"
            raise ConfigError(problem, path=str(path), topic=FLAG)
        data = path.read_bytes() if path.stat().st_size <= _MAX_BYTES else b""
        head = read_png_head(data)
    except (OSError, ValueError) as error:
        problem = f"can't be read ({getattr(error, 'strerror', None) or error})"
        raise ConfigError(problem, path=str(path), topic=FLAG, remedy="pass a PNG file") from error
    image = None
    if 0 < head.width * head.height <= MAX_PIXELS:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        problem = f"the PNG of {head.width}x{head.height} pixels can't be decoded"
        raise ConfigError(problem, path=str(path), topic=FLAG, remedy="save it again")
    return image.reshape(*image.shape[:2], -1)[..., :3].max(axis=-1) == 0
