"""Layouts of data sets that differ from the basic one: 7-Scenes, ScanNet, SUN3D and SUN RGB-D.

Sources: the web page of 7-Scenes; ScanNet's ``SensReader``; SUN3D's ``SUN3Dsfm``.
"""

from collections.abc import Sequence
from pathlib import Path

from jaxdet.io.folders import basic
from jaxdet.io.folders.recording import Cameras, Image, ImageFiles, Recording, image_size
from jaxdet.io.folders.text import read_matrix
from jaxdet.types import Intrinsics

FLAT_COLOR = ImageFiles((), (".color.png", ".color.jpg", ".color.jpeg"))
FLAT_DEPTH = ImageFiles((), (".depth.png",))
SUN3D_MATRIX = "intrinsics.txt"


def read_7_scenes(folder: Path) -> Recording | None:
    """Read a folder that itself has the images, ``frame-000000.color.png`` and ``.depth.png``."""
    if not FLAT_DEPTH.paths(folder):
        return None
    return basic.read(folder, FLAT_COLOR, FLAT_DEPTH)


def read_scannet(folder: Path) -> Recording | None:
    """Read a folder with the camera matrices (4, 4) of both images in ``intrinsic``."""
    if not (folder / "intrinsic").is_dir():
        return None
    return basic.read(folder, cameras=_scannet_cameras)


def _scannet_cameras(folder: Path, color: Sequence[Image], depth: Sequence[Image]) -> Cameras:
    matrices = folder / "intrinsic"
    return Cameras(
        _camera(matrices / "intrinsic_color.txt", 4, color),
        _camera(matrices / "intrinsic_depth.txt", 4, depth),
    )


def read_sun3d(folder: Path) -> Recording | None:
    """Read a folder with the camera matrix (3, 3) in ``intrinsics.txt``, and rotated depth."""
    if not (folder / SUN3D_MATRIX).is_file():
        return None
    return basic.read(folder, cameras=_sun3d_cameras)._replace(is_rotated=True)


def _sun3d_cameras(folder: Path, color: Sequence[Image], _: Sequence[Image]) -> Cameras:
    return Cameras(_camera(folder / SUN3D_MATRIX, 3, color))


def _camera(path: Path, rows: int, images: Sequence[Image]) -> Intrinsics | None:
    """Return the camera of images from a file with its matrix; None if one of them is missing."""
    if not path.is_file() or not (size := image_size(images)):
        return None
    K = read_matrix(path, rows)
    return Intrinsics(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
