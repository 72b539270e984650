"""Conversion of NumPy columns to Arrow arrays, and of columns of lists to NumPy arrays.

Arrow arrays are made from the memory of NumPy arrays: ``pa.array`` and, in earlier versions,
``to_pandas_dtype`` import pandas if it is installed, which takes a third of a second and 40 MB in
each process.
"""

import os
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from jaxdet.results.lists import Lists

_NUMPY = {
    pa.int8(): np.int8,
    pa.int32(): np.int32,
    pa.int64(): np.int64,
    pa.float32(): np.float32,
    pa.float64(): np.float64,
}


def open_file(path: Path, mode: Literal["rb", "wb"]) -> pa.NativeFile:
    """Open a file for Arrow, whose own functions refuse paths that aren't UTF-8.

    Raises:
        OSError: It can't be opened.
    """
    return pa.OSFile(os.fsencode(path), mode)


def map_file(path: Path) -> pa.NativeFile:
    """Map a file into memory for Arrow, even if its path isn't UTF-8.

    Raises:
        OSError: It can't be opened.
    """
    return pa.memory_map(os.fsencode(path))


def to_array(values: Any, field: pa.Field) -> pa.Array:
    """Return a column as an Arrow array.

    Args:
        values: ``(R,)`` numbers, booleans or strings, ``(R, n)`` for lists of n, or
            :class:`jaxdet.results.lists.Lists`. In a nullable field, masked values, NaN and lists
            that contain such values are null.
        field: Field of the column, with its type and whether it is nullable.
    """
    if isinstance(values, Lists):
        flat = _numbers(values.values, field.type.value_type)
        offsets = np.ascontiguousarray(values.offsets, np.int32)
        return _array(field.type, values.null, [pa.py_buffer(offsets)], [flat])
    null, data = np.zeros(len(values), bool), np.ma.getdata(values)
    if field.nullable:
        none = np.ma.getmaskarray(values)
        if np.issubdtype(data.dtype, np.floating):
            none = none | np.isnan(data)
        data, null = np.where(none, 0, data), np.asarray(none.any(axis=tuple(range(1, none.ndim))))
    if pa.types.is_fixed_size_list(field.type):
        flat = _numbers(data.reshape(-1), field.type.value_type)
        return _array(field.type, null, [], [flat])
    if pa.types.is_string(field.type):
        return _strings(data, null)
    return _numbers(data, field.type, null)


def _numbers(values: np.ndarray, kind: pa.DataType, null: np.ndarray | None = None) -> pa.Array:
    if pa.types.is_boolean(kind):
        memory = np.packbits(np.asarray(values, bool), bitorder="little")
    else:
        memory = np.ascontiguousarray(values, _NUMPY[kind])
    null = np.zeros(len(values), bool) if null is None else null
    return _array(kind, null, [pa.py_buffer(memory)])


def _strings(values: np.ndarray, null: np.ndarray) -> pa.Array:
    given = np.where(null, "", values).tolist()
    known = {text: text.encode() for text in set(given)}
    texts = [known[text] for text in given]
    ends = np.zeros(len(texts) + 1, np.int32)
    np.cumsum([len(text) for text in texts], out=ends[1:])
    return _array(pa.string(), null, [pa.py_buffer(ends), pa.py_buffer(b"".join(texts))])


def _array(
    kind: pa.DataType,
    null: np.ndarray,
    buffers: list[pa.Buffer],
    children: list[pa.Array] | None = None,
) -> pa.Array:
    count = int(np.count_nonzero(null))
    valid = pa.py_buffer(np.packbits(~null, bitorder="little")) if count else None
    return pa.Array.from_buffers(kind, len(null), [valid, *buffers], count, children=children)


def list_array(column: pa.ChunkedArray) -> pa.ListArray:
    """Return a column of lists as one array."""
    array = column.combine_chunks()
    return array.chunk(0) if isinstance(array, pa.ChunkedArray) else array


def vectors(column: pa.ChunkedArray, size: int) -> np.ndarray:
    """Return vectors ``(N, size)`` of the column's type, NaN for null."""
    values = list_array(column).flatten().to_numpy().reshape(-1, size)
    found = np.full((len(column), size), np.nan, values.dtype)
    found[column.is_valid().to_numpy()] = values
    return found
