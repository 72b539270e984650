"""Layouts of folders of images: recognition and reading.

A new layout is a function that reads a folder with this layout as a
:class:`~jaxdet.io.folders.recording.Recording`, and an item of :data:`LAYOUTS`.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from jaxdet.io.folders import basic, datasets, phones
from jaxdet.io.folders.recording import COLOR, DEPTH, ImageFiles, Recording


class Layout(NamedTuple):
    """A layout of folders of images."""

    names: str
    """Names of data sets and programs with this layout."""
    read: Callable[[Path], Recording | None]
    """Function that reads a folder, and returns None if the folder has another layout.

    It raises ``InputError`` if the folder has this layout, but is damaged.
    """
    color: ImageFiles = COLOR
    depth: ImageFiles = DEPTH
    without_color: str = ""
    """Name of a file that identifies recordings without colour images."""


LAYOUTS = (
    Layout("Stray Scanner", phones.read_stray_scanner, without_color=phones.ODOMETRY),
    Layout("Record3D", phones.read_record3d),
    Layout("7-Scenes", datasets.read_7_scenes, datasets.FLAT_COLOR, datasets.FLAT_DEPTH),
    Layout("SUN3D, SUN RGB-D", datasets.read_sun3d),
    Layout("ScanNet", datasets.read_scannet),
    Layout("TUM, Open3D, Redwood", basic.read),
)
"""All layouts; the first one that can read a folder is used."""


def image_folders(files: Sequence[Path]) -> list[Path]:
    """Return the folders of the files that contain both colour and depth images, in order."""
    colors = {layout.color for layout in LAYOUTS}
    depths = {layout.depth for layout in LAYOUTS}
    marks = {layout.without_color for layout in LAYOUTS}
    with_color = {kind.folder_of(file) for kind in colors for file in files}
    with_color |= {file.parent for file in files if file.name in marks}
    with_depth = {kind.folder_of(file) for kind in depths for file in files}
    return sorted(folder for folder in with_color & with_depth if folder)


def read_recording(folder: Path) -> Recording:
    """Read a folder of images in the layout that it has.

    Raises:
        InputError: The folder is damaged.
        OSError: A file can't be read.
    """
    found = (layout.read(folder) for layout in LAYOUTS)
    return next(recording for recording in found if recording)
