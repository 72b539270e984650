"""Cells: depth in square blocks, in space and in the colour image.

Twin of ``jaxdet/reference/_cells.py``. Compiled without fused multiply-add, as the alignment whose
projection it uses.
"""

import warp as wp

from jaxdet_kernels.align import align_project
from jaxdet_kernels.native_source import native

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

RAY_BITS, RAY_HALF = wp.constant(wp.int64(20)), wp.constant(wp.int64(1 << 19))
"""Fraction bits of rays, and half of one."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return blockDim.x;
#else
    return 1;
#endif
""")
def team_size() -> int:  # pyright: ignore[reportReturnType]
    """Threads that work on one frame together."""


@wp.func_native(
    native(
        "cell_depth.h",
        body="""
    const size_t row = ((size_t)b * depth.shape[1] + top) * depth.shape[2];
    const CellDepth cell{depth.data + row + left, depth.shape[2], side, near.data};
    return cell.depth();
""",
    )
)
def cell_depth(
    depth: wp.array3d[wp.uint16], b: int, top: int, left: int, side: int, near: wp.array[wp.int32]
) -> int:  # pyright: ignore[reportReturnType]
    """The depth of the cell at a pixel, 0 = none."""


@wp.func
def cell_moved(ray: wp.int32, d: int, offset: wp.int32):
    """``ray d + offset``, rounded."""
    return int((wp.int64(ray) * wp.int64(d) + RAY_HALF) >> RAY_BITS) + offset


@wp.func
def cell_box(
    d: int,
    top: int,
    left: int,
    side: int,
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    model: int,
    aligned: int,
):
    """What a cell covers in the colour image: left, top, right, bottom; (0, 0, -1, -1): nothing."""
    if aligned != 0:
        return wp.vec4i(left, top, left + side - 1, top + side - 1)
    units = wp.uint16(d)
    v = top + side
    u = left + side
    one = align_project(units, corner_x[top, left], corner_y[top, left], parameters, model)
    two = align_project(units, corner_x[v, u], corner_y[v, u], parameters, model)
    if one[2] < 0 or two[2] < 0:
        return wp.vec4i(0, 0, -1, -1)
    return wp.vec4i(
        wp.min(one[0], two[0]),
        wp.min(one[1], two[1]),
        wp.max(one[0], two[0]),
        wp.max(one[1], two[1]),
    )


@wp.kernel(launch_bounds=(256, 4))
def cells(
    share: int,
    shares: int,
    depth: wp.array3d[wp.uint16],
    near: wp.array[wp.int32],
    rays: wp.array3d[wp.int32],
    offset: wp.array[wp.int32],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    last: wp.array[wp.int32],
    side: int,
    model: int,
    aligned: int,
    x_out: wp.array3d[wp.int32],
    y_out: wp.array3d[wp.int32],
    z_out: wp.array3d[wp.int32],
    uv_min_out: wp.array4d[wp.int32],
    uv_max_out: wp.array4d[wp.int32],
    in_view_out: wp.array3d[wp.bool],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        depth: ``(B, Hd, Wd)`` [depth units], 0 = no measurement.
        near: By depth, how far from a cell's median its depths count [depth units].
        rays: ``(3, R, C)``, the cells' rays in the colour camera, ``RAY_BITS`` fraction bits.
        offset: ``(3,)``, the depth camera there [depth units].
        corner_x: ``(Hd + 1, Wd + 1)``, the rays of the depth pixels' corners; not read if aligned.
        corner_y: Likewise.
        parameters: Of the alignment, likewise.
        last: ``(2,)``, the last column and row of the colour image.
        side: Of a cell [pixel].
        model: The colour camera's lens.
        aligned: 1 where depth is aligned to colour already.
        x_out: ``(B, R, C)``, colour optical frame [depth units].
        y_out: Likewise.
        z_out: Likewise, 0 = no measurement.
        uv_min_out: ``(B, R, C, 2)``, first colour column and row of a cell in view, else 0.
        uv_max_out: Last.
        in_view_out: ``(B, R, C)``.
        scratch_out: Not used.
    """
    tid = wp.tid()
    size = team_size()
    rows = z_out.shape[1]
    columns = z_out.shape[2]
    for b in range(share + tid // size, depth.shape[0], shares):
        row = (tid % size) // columns
        column = (tid % size) % columns
        while row < rows:
            top = row * side
            left = column * side
            d = cell_depth(depth, b, top, left, side, near)
            z = cell_moved(rays[2, row, column], d, offset[2])
            seen = d > 0 and z > 0
            box = wp.vec4i(0, 0, -1, -1)
            if seen:
                box = cell_box(d, top, left, side, corner_x, corner_y, parameters, model, aligned)
            inside = box[2] >= 0 and box[3] >= 0 and box[0] <= last[0] and box[1] <= last[1]
            x = cell_moved(rays[0, row, column], d, offset[0])
            y = cell_moved(rays[1, row, column], d, offset[1])
            x_out[b, row, column] = wp.where(seen, x, 0)
            y_out[b, row, column] = wp.where(seen, y, 0)
            z_out[b, row, column] = wp.where(seen, wp.min(z, 65535), 0)
            in_view_out[b, row, column] = inside
            for axis in range(2):
                low = wp.clamp(box[axis], 0, last[axis])
                high = wp.clamp(box[axis + 2], 0, last[axis])
                uv_min_out[b, row, column, axis] = wp.where(inside, low, 0)
                uv_max_out[b, row, column, axis] = wp.where(inside, high, 0)
            row += size // columns
            column += size % columns
            if column >= columns:
                row += 1
                column -= columns
