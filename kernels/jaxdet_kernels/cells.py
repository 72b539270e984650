"""Cells: depth in square blocks, in space and in the colour image.

Twin of ``jaxdet/reference/_cells.py``. Compiled without fused multiply-add, as the alignment is.
"""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, includes, team_kernel

wp.set_module_options(
    {
        "fuse_fp": False,
        "enable_backward": False,
        "cpu_compiler_flags": CPU_FLAGS,
        "extra_build_options": includes("cells.h"),
    }
)


@team_kernel(
    body="""
        const int height = depth.shape[1], width = depth.shape[2];
        const int rows = z_out.shape[1], columns = z_out.shape[2];
        const size_t i = (size_t)b * rows * columns;
        CellGrid{depth.data + (size_t)b * height * width, width, rows, columns, side, near.data,
                 rays.data, offset.data, corner_x.data, corner_y.data, {parameters.data, model},
                 last.data, aligned != 0, x_out.data + i, y_out.data + i, z_out.data + i,
                 (int*)uv_min_out.data + i, (int*)uv_max_out.data + i, in_view_out.data + i}
            .run(team);
""",
)
def cells(
    depth: wp.array3d[wp.uint16],  # (B, Hd, Wd) [depth units], 0 = no measurement
    near: wp.array[wp.int32],  # by depth, how far from a cell's median its depths count
    rays: wp.array3d[wp.int32],  # (3, R, C) in the colour camera, RAY_BITS fraction bits
    offset: wp.array[wp.int32],  # (3,) the depth camera there [depth units]
    corner_x: wp.array2d[wp.float32],  # (R + 1, C + 1) rays of the cells' corners; not if aligned
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],  # of the alignment, likewise
    last: wp.array[wp.int32],  # (2,) last column and row of the colour image
    side: int,  # of a cell [pixel]
    model: int,  # the colour camera's lens
    aligned: int,  # 1 where depth is aligned to colour already
    x_out: wp.array3d[wp.int32],  # (B, R, C) colour optical frame [depth units]
    y_out: wp.array3d[wp.int32],
    z_out: wp.array3d[wp.int32],  # 0 = no measurement
    uv_min_out: wp.array4d[wp.int16],  # (B, R, C, 2) first colour column and row, 0 if not in view
    uv_max_out: wp.array4d[wp.int16],  # last
    in_view_out: wp.array3d[wp.bool],
):
    """The cells of each frame."""
