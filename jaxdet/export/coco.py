"""``--to coco``: images, boxes and masks as a training set (COCO instances)."""

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np

from jaxdet.camera import cell_side
from jaxdet.config import Config
from jaxdet.errors import ConfigError, FrameStatus, JaxdetError
from jaxdet.export.recordings import Seen, look_again, recorded
from jaxdet.io import LogFiles
from jaxdet.render.camera import shown_image
from jaxdet.results.masks import label_image
from jaxdet.results.reading import ResultLog, Results

QUALITY = 95
"""Quality of the JPEG images."""
CATEGORY = {"id": 1, "name": "obstacle", "supercategory": "obstacle"}


def export(results: Results, output: Path, recordings: Mapping[str, LogFiles]) -> list[str]:
    """Write a folder with ``images/`` and ``annotations.json``.

    Images are the colour images, or depth images in false colours for frames without colour.
    Annotations are the boxes and masks of obstacles. Frames without a result are omitted; ``info``
    in ``annotations.json`` has their number and that of the depth images. A log that was not passed
    and can't be read at its original path is omitted, with a line in ``info``.

    Masks are computed again from the logs; it is an error if the obstacles differ from the results.
    If ``jaxdet track`` was run, annotations have a ``track_id``, which may be null.

    Args:
        results: Results of a run.
        output: Folder to write.
        recordings: Logs of the results by name; others are read from their original paths.

    Returns:
        A line for each omitted log.

    Raises:
        ConfigError: The results are from the preset ``paper``, which has no masks.
        InputError: A passed log is not the one in the results, or no log can be read.
    """
    if results.method.cluster.points:
        raise ConfigError(
            "the preset paper has no masks",
            path=str(results.folder),
            remedy="run jaxdet run with another preset",
        )
    (output / "images").mkdir(parents=True)
    failed: dict[str, JaxdetError] = {}
    with _Annotations(output) as annotations:
        for log in results.logs:
            annotations.begin()
            try:
                files = recordings.get(log.name) or recorded(log)
                for seen in look_again(results, log, files, with_cells=True, color=True):
                    _add(annotations, log, seen, results.method)
            except JaxdetError as error:
                if log.name in recordings or len(results.logs) == 1:
                    raise
                annotations.take_back()
                failed[log.label] = error
        if failed and len(failed) == len(results.logs):
            raise next(iter(failed.values()))
        left_out = [f"{label} is left out: {error}" for label, error in failed.items()]
        annotations.finish(results, left_out)
    return left_out


def _add(annotations: "_Annotations", log: ResultLog, seen: Seen, config: Config) -> None:
    """Add the frames of a batch."""
    rows, first = seen.chunk.frames.to_pylist(), seen.chunk.first.tolist()
    obstacles, frames = seen.chunk.obstacles.to_pylist(), seen.batch.frames
    assert seen.found.cells is not None
    for b, row in enumerate(rows):
        if row["status"] != FrameStatus.OK:
            annotations.lost += 1
            continue
        shown = shown_image(frames, b, config)
        side = cell_side(frames.calibration.depth, config.surface.cell_rad)
        labels = label_image(seen.found.cells, b, shown.calibration, side)
        name = f"images/{log.file_name}_{row['frame']:06d}.jpg"
        own, of_depth = obstacles[first[b] : first[b + 1]], shown.depth_range_m is not None
        annotations.add(name, shown.image, row, own, labels, of_depth=of_depth)


class _Annotations:
    """Incremental writer of ``annotations.json``."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.images, self.objects, self.lost, self.of_depth = 0, 0, 0, 0
        self._images, self._objects = _Lines(), _Lines()
        self.begin()

    def __enter__(self) -> "_Annotations":
        return self

    def __exit__(self, *_: object) -> None:
        self._images.file.close()
        self._objects.file.close()

    def begin(self) -> None:
        """Start a log."""
        self._before = self.images, self.objects, self.lost, self.of_depth
        self._names: list[str] = []
        self._images.mark()
        self._objects.mark()

    def take_back(self) -> None:
        """Remove the frames of the current log."""
        self.images, self.objects, self.lost, self.of_depth = self._before
        for name in self._names:
            (self.folder / name).unlink()
        self._images.take_back()
        self._objects.take_back()

    def add(
        self,
        name: str,
        color: np.ndarray,
        row: Mapping[str, Any],
        obstacles: Sequence[Mapping[str, Any]],
        labels: np.ndarray,
        *,
        of_depth: bool,
    ) -> None:
        """Add a frame: its image ``(H, W, 3)`` RGB, and the label of each pixel, ``(H, W)``."""
        self.of_depth += of_depth
        encoded = cv2.imencode(".jpg", color[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
        self._names.append(name)
        (self.folder / name).write_bytes(encoded.tobytes())
        self.images += 1
        height, width = labels.shape
        about = {name: row[name] for name in ("log", "camera", "frame", "stamp_ns")}
        size = {"width": width, "height": height}
        self._images.add({"id": self.images, "file_name": name, **size, **about})
        for obstacle in obstacles:
            seen = labels == obstacle["obstacle"]
            box = _box(obstacle, seen, of_depth=of_depth)
            if box is None:
                continue
            self.objects += 1
            place = {"id": self.objects, "image_id": self.images, "category_id": CATEGORY["id"]}
            self._objects.add({**place, **_annotation(obstacle, seen, box)})

    def finish(self, results: Results, left_out: Sequence[str]) -> None:
        """Write the file; ``left_out`` has one line per omitted log."""
        info = {
            "description": "obstacles found by jaxdet",
            "version": results.version,
            "frames_without_result": self.lost,
            "images_of_depth": self.of_depth,
            "left_out": left_out,
        }
        head = {"info": info, "licenses": [], "categories": [CATEGORY]}
        with (self.folder / "annotations.json").open("w", encoding="utf-8") as file:
            file.write(json.dumps(head, ensure_ascii=False)[:-1])
            for key, lines in (("images", self._images), ("annotations", self._objects)):
                file.write(f', "{key}": [\n')
                file.writelines(lines.joined())
                file.write("\n]")
            file.write("}\n")


class _Lines:
    """JSON values in a temporary file, one per line."""

    def __init__(self) -> None:
        self.file: IO[str] = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115

    def mark(self) -> None:
        self._mark = self.file.tell()

    def take_back(self) -> None:
        """Remove the values since the mark."""
        self.file.seek(self._mark)
        self.file.truncate()

    def add(self, value: Mapping[str, Any]) -> None:
        self.file.write(json.dumps(value, ensure_ascii=False, allow_nan=False) + "\n")

    def joined(self) -> Iterator[str]:
        self.file.seek(0)
        for number, line in enumerate(self.file):
            yield (",\n" if number else "") + line.rstrip("\n")


def _box(obstacle: Mapping[str, Any], mask: np.ndarray, *, of_depth: bool) -> list[int] | None:
    """Return left, top, width and height of an obstacle in its image; None if it is outside.

    If there is a colour camera, the box in the table refers to the colour image. In the depth image
    of a frame without colour, the bounding box of the mask is used instead.
    """
    if of_depth and obstacle["box_image"] == "color":
        rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
        if not rows.size:
            return None
        left, right, top, bottom = *columns[[0, -1]].tolist(), *rows[[0, -1]].tolist()
    else:
        left, right, top, bottom = (obstacle[name] for name in ("u_min", "u_max", "v_min", "v_max"))
        if left is None:
            return None
    return [left, top, right + 1 - left, bottom + 1 - top]


def _annotation(obstacle: Mapping[str, Any], mask: np.ndarray, box: list[int]) -> dict[str, Any]:
    """Return box and mask ``(H, W)`` of an obstacle as an annotation."""
    return {
        "bbox": box,
        "area": int(mask.sum()),
        "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
        "iscrowd": 0,
        **{name: obstacle[name] for name in ("obstacle", "distance_m", "bottom_m", "top_m")},
        **({"track_id": obstacle["track"]} if "track" in obstacle else {}),
    }


def run_lengths(mask: np.ndarray) -> list[int]:
    """Encode a mask ``(H, W)`` bool as COCO run lengths, of zeros and ones, column by column."""
    flat = mask.ravel(order="F")
    ends = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    runs = np.diff(np.concatenate([[0], ends, [flat.size]])).tolist()
    return [0, *runs] if flat[0] else runs
