"""Layouts of folders of images, including those of data sets that differ little from the basic one.

A new layout is a function that reads a folder with this layout as a
:class:`~jaxdet.io.folders.recording.Recording`, and an item of :data:`LAYOUTS`.

Sources: the web pages of 7-Scenes and OpenLORIS; ScanNet's ``SensReader``; SUN3D's ``SUN3Dsfm``.
"""

from collections.abc import Callable, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from jaxdet.io.folders import basic, phones
from jaxdet.io.folders.recording import (
    DEPTH,
    Cameras,
    Image,
    ImageFiles,
    Recording,
    entry,
    image_size,
    read_matrix,
)
from jaxdet.types import Intrinsics

_FLAT_COLOR = ImageFiles((), (".color.png", ".color.jpg", ".color.jpeg"))
_FLAT_DEPTH = ImageFiles((), (".depth.png",))
_FLAT_POSES = ImageFiles((), (".pose.txt",))
_ALIGNED_DEPTH = ImageFiles(("aligned_depth",), DEPTH.endings)
_SUN3D_MATRIX = "intrinsics.txt"


class Layout(NamedTuple):
    """A layout of folders of images."""

    names: str
    """Names of data sets and programs with this layout."""
    read: Callable[[Path], Recording | None]
    """Function that reads a folder, and returns None if the folder has another layout.

    It raises ``InputError`` if the folder has this layout, but is damaged.
    """
    depth: ImageFiles = DEPTH


def _read_7_scenes(folder: Path) -> Recording | None:
    """Read a folder that directly contains images ``frame-000000.color.png`` and ``.depth.png``."""
    if not _FLAT_DEPTH.paths(folder):
        return None
    return basic.read(folder, _FLAT_COLOR, _FLAT_DEPTH, poses=_FLAT_POSES)


def _read_scannet(folder: Path) -> Recording | None:
    """Read a folder with camera matrices (4, 4), such as ``intrinsic/intrinsic_color.txt``.

    In ScanNet's small subset (``scannet_frames_25k``), it is ``intrinsics_color.txt``.
    """
    color, depth = (
        next(chain(folder.glob(f"intrinsic/{name}"), folder.glob(name)), None)
        for name in ("intrinsic*_color.txt", "intrinsic*_depth.txt")
    )
    if not (color or depth):
        return None

    def cameras(_: Path, colors: Sequence[Image], depths: Sequence[Image]) -> Cameras:
        return Cameras(color and _camera(color, 4, colors), depth and _camera(depth, 4, depths))

    return basic.read(folder, cameras=cameras)


def _read_openloris(folder: Path) -> Recording | None:
    """Read a folder with depth aligned to colour in ``aligned_depth``, next to raw depth."""
    if not _ALIGNED_DEPTH.paths(folder):
        return None
    return basic.read(folder, depth=_ALIGNED_DEPTH)


def _read_sun3d(folder: Path) -> Recording | None:
    """Read a folder with the camera matrix (3, 3) in ``intrinsics.txt``; depth bits are rotated."""
    if not entry(folder, _SUN3D_MATRIX).is_file():
        return None
    return basic.read(folder, cameras=_sun3d_cameras)._replace(is_rotated=True)


def _sun3d_cameras(folder: Path, color: Sequence[Image], depth: Sequence[Image]) -> Cameras:
    return Cameras(_camera(entry(folder, _SUN3D_MATRIX), 3, color or depth))


def _camera(path: Path, rows: int, images: Sequence[Image]) -> Intrinsics | None:
    """Return intrinsics from a file with the camera matrix; None without images."""
    if not (size := image_size(images)):
        return None
    K = read_matrix(path, rows)
    return Intrinsics(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2])


LAYOUTS = (
    Layout("Stray Scanner", phones.read_stray_scanner),
    Layout("Record3D", phones.read_record3d),
    Layout("7-Scenes", _read_7_scenes, _FLAT_DEPTH),
    Layout("SUN3D, SUN RGB-D", _read_sun3d),
    Layout("ScanNet", _read_scannet),
    Layout("OpenLORIS", _read_openloris, depth=_ALIGNED_DEPTH),
    Layout("TUM, Open3D, Redwood", basic.read),
)
"""All layouts; the first one that can read a folder is used."""


def image_folders(files: Sequence[Path]) -> list[Path]:
    """Return the folders of recordings whose depth images are among the files, in order."""
    depths = {layout.depth for layout in LAYOUTS}
    found = {kind.folder_of(file) for kind in depths for file in files}
    return sorted(folder for folder in found if folder)


def read_recording(folder: Path) -> Recording:
    """Read a folder of images in the layout that it has.

    Raises:
        InputError: The folder is damaged.
        OSError: A file can't be read.
    """
    found = (layout.read(folder) for layout in LAYOUTS)
    return next(recording for recording in found if recording)
