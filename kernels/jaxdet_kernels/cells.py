"""Cells: depth in square blocks. Twin of ``jaxdet/reference/_cells.py``."""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, team_kernel

wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})


@team_kernel(
    "cells.h",
    body="""
        const int height = depth.shape[1], width = depth.shape[2];
        const int rows = z_out.shape[1], columns = z_out.shape[2];
        const size_t i = (size_t)b * rows * columns;
        CellGrid{depth.data + (size_t)b * height * width, width, rows, columns, side, near.data,
                 rays.data, x_out.data + i, y_out.data + i, z_out.data + i}.run(team);
""",
)
def cells(
    depth: wp.array3d[wp.uint16],  # (B, Hd, Wd) [depth units], 0 = no measurement
    near: wp.array[wp.int32],  # by depth, how far from a cell's median its depths count
    rays: wp.array3d[wp.int32],  # (2, R, C) x and y over z, RAY_BITS fraction bits
    side: int,  # of a cell [pixel]
    x_out: wp.array3d[wp.int32],  # (B, R, C) depth optical frame [depth units]
    y_out: wp.array3d[wp.int32],
    z_out: wp.array3d[wp.int32],  # 0 = no measurement
):
    """The cells of each frame."""
