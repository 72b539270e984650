"""Cells: depth in square blocks, in space and in the colour image.

Twin of ``jaxdet/reference/_cells.py``. Compiled without fused multiply-add, as the alignment is.
"""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, native_kernel

wp.set_module_options({"fuse_fp": False, "enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})


@native_kernel(
    "lanes.h",
    "vectors.h",
    "cell_depth.h",
    "pixel_pair.h",
    "projection.h",
    "cells.h",
    body="""
    const Team team(tid, share);
    const int height = depth.shape[1], width = depth.shape[2];
    const int rows = z_out.shape[1], columns = z_out.shape[2];
    for (int b = team.index; b < depth.shape[0]; b += shares) {
        const size_t i = (size_t)b * rows * columns;
        CellGrid{depth.data + (size_t)b * height * width, width, rows, columns, side,
                 near.data, rays.data, offset.data, corner_x.data, corner_y.data,
                 {parameters.data, model}, last.data, aligned != 0,
                 x_out.data + i, y_out.data + i, z_out.data + i,
                 (int*)uv_min_out.data + i, (int*)uv_max_out.data + i, in_view_out.data + i}
            .run(team);
    }
""",
)
def cells(
    tid: int,
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
    uv_min_out: wp.array4d[wp.int16],
    uv_max_out: wp.array4d[wp.int16],
    in_view_out: wp.array3d[wp.bool],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        tid: Of the launch.
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        depth: ``(B, Hd, Wd)`` [depth units], 0 = no measurement.
        near: By depth, how far from a cell's median its depths count [depth units].
        rays: ``(3, R, C)``, the cells' rays in the colour camera, ``RAY_BITS`` fraction bits.
        offset: ``(3,)``, the depth camera there [depth units].
        corner_x: ``(R + 1, C + 1)``, the rays of the cells' corners; not read if aligned.
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
