"""Pictures as data URLs."""

from base64 import b64encode
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from jaxdet.errors import InputError

WIDTH = 1024
"""Maximum width of pictures [pixel]."""
QUALITY = 74


def data_url(image: np.ndarray, quality: int) -> str:
    """Encode a BGR picture, with or without alpha, as WebP in a ``data:`` URL."""
    encoded = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, quality])[1]
    return f"data:image/webp;base64,{b64encode(encoded.tobytes()).decode()}"


def frame_picture(picture: np.ndarray) -> dict[str, Any]:
    """Encode the picture of a frame, ``(h, w, 3)`` uint8 BGR, for the page, with its size."""
    height, width = picture.shape[:2]
    if width > WIDTH:
        size = (WIDTH, round(height * WIDTH / width))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return {"picture": data_url(picture, QUALITY), "size": picture.shape[1::-1]}


def read_picture(path: Path) -> np.ndarray:
    """Read a picture of a results folder, ``(h, w, 3)`` uint8 BGR.

    Raises:
        InputError: The file can't be read, or is not a picture.
    """
    remedy = "remove it, so that it is drawn from the log, or run jaxdet run again"
    try:
        data = np.frombuffer(path.read_bytes(), np.uint8)  # imread would print warnings
    except OSError as error:
        problem = f"the picture can't be read ({error.strerror})"
        raise InputError(problem, path=str(path), remedy=remedy) from error
    picture = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if picture is None:
        raise InputError("the picture is damaged", path=str(path), remedy=remedy)
    return picture
