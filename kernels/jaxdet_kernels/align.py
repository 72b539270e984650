"""Stage align: depth pixels splatted into the colour image, the nearest wins.

Twin of ``jaxdet/reference/_align.py`` and ``_lens.py``, operation by operation. The module is
compiled without fused multiply-add, so that every operation is rounded on its own.

A key is ``depth << 16 | z`` (depth in the depth camera, z in the colour camera), so one unsigned
minimum decides on both, whatever the order of the writes. z stays below 65535, so that no key
equals the initial one, all bits set.
"""

import warp as wp

from jaxdet_kernels.native_source import native

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

PINHOLE, PLUMB_BOB, RATIONAL, EQUIDISTANT = 0, 1, 2, 3
"""Lens models, by number."""

PARAMETERS = 26
"""Length of ``parameters``: rotation 0-8, translation 9-11, fx fy cx cy 12-15, lens 16-23,
largest squared slope 24, metres in a depth unit 25."""

Box = wp.types.vector(length=5, dtype=wp.int32)
"""Left, top, right, bottom, z."""


@wp.func_native(
    native(
        "projection.h",
        body="""
    const Projection::Point at = Projection{p.data, model}.point(units, x, y);
    return wp::vec_t<3, int>(at.u, at.v, at.seen ? at.z : -1);
""",
    )
)
def align_project(
    units: wp.uint16, x: wp.float32, y: wp.float32, p: wp.array[wp.float32], model: int
) -> wp.vec3i:  # pyright: ignore[reportReturnType]
    """Colour column, row and z of a ray at a depth; z = -1 where it can't be seen."""


@wp.func
def align_rectangle(
    units: wp.uint16,
    v: int,
    u: int,
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    p: wp.array[wp.float32],
    model: int,
    fills: int,
    height: int,
    width: int,
):
    """The colour pixels that a depth pixel covers, clipped: left, top, right, bottom, z.

    Empty (right < left) where the pixel is not seen.
    """
    none = Box(0, 0, -1, -1, 0)
    first = align_project(units, corner_x[v, u], corner_y[v, u], p, model)
    if first[2] < 0:
        return none
    last = first
    if fills != 0:
        last = align_project(units, corner_x[v + 1, u + 1], corner_y[v + 1, u + 1], p, model)
        if last[2] < 0:
            return none
    return Box(
        wp.max(first[0], 0),
        wp.max(first[1], 0),
        wp.min(last[0], width - 1),
        wp.min(last[1], height - 1),
        first[2],
    )


@wp.kernel
def align_splat(
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    model: int,
    fills: int,
    keys_out: wp.array3d[wp.uint32],
):
    """A thread a depth pixel, atomic minimum; for CUDA."""
    b, v, u = wp.tid()
    units = depth[b, v, u]
    if units == wp.uint16(0):
        return
    box = align_rectangle(
        units, v, u, corner_x, corner_y, parameters, model, fills,
        keys_out.shape[1], keys_out.shape[2],
    )  # fmt: skip
    key = (wp.uint32(units) << wp.uint32(16)) | wp.uint32(box[4])
    for row in range(box[1], box[3] + 1):
        for column in range(box[0], box[2] + 1):
            wp.atomic_min(keys_out, b, row, column, key)


@wp.kernel
def align_splat_rows(
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    model: int,
    fills: int,
    keys_out: wp.array3d[wp.uint32],
):
    """A thread a depth row without atomics; for the CPU, where Warp runs threads one by one."""
    b, v = wp.tid()
    for u in range(depth.shape[2]):
        units = depth[b, v, u]
        if units != wp.uint16(0):
            box = align_rectangle(
                units, v, u, corner_x, corner_y, parameters, model, fills,
                keys_out.shape[1], keys_out.shape[2],
            )  # fmt: skip
            key = (wp.uint32(units) << wp.uint32(16)) | wp.uint32(box[4])
            for row in range(box[1], box[3] + 1):
                for column in range(box[0], box[2] + 1):
                    if key < keys_out[b, row, column]:
                        keys_out[b, row, column] = key
