"""Obstacles measured and outlined on all of their cells.

Twin of ``jaxdet/reference/_outlines.py`` and of ``footprint_on_floor`` in ``_footprint.py``.
Compiled without fused multiply-add, as boxes are projected in the arithmetic of the alignment.
"""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, team_kernel

wp.set_module_options({"fuse_fp": False, "enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})

DIRECTIONS = 90
PARTS = 2


def scratch_words(rows: int, columns: int, slots: int) -> int:
    """32-bit words of scratch memory of a team, an even number of them.

    Args:
        rows: Of the grid.
        columns: Likewise.
        slots: Most obstacles of a frame.
    """
    by_slot = 2 * columns + 3 * DIRECTIONS + 2 + 2 * PARTS
    words = slots * by_slot + 2 + 8 * rows * columns
    return words + words % 2


@team_kernel(
    "outlines.h",
    body="""
        const Warp warp(team);
        const int columns = label.shape[2], grid = label.shape[1] * columns;
        const int slots = num_points_out.shape[1];
        const size_t at = (size_t)b * grid, slot = (size_t)b * slots;
        const int found = count.data[b] < slots ? count.data[b] : slots;

        ObstacleCells cells{team, grid, columns, found, Margins(columns), label.data + at,
                            right.data + at, forward.data + at};
        const CellBoxes boxes{columns, side, corner_x.data, corner_y.data, {parameters.data, model},
                              last.data, aligned != 0};
        const Measures measures{cells, warp, settings.data[Outlines::TRIM],
                                settings.data[Outlines::VERTEX], bands.data,
                                {x.data + at, y.data + at, z.data + at}, height.data + at,
                                boxes, num_points_out.data + slot, uv_min_out.data + 2 * slot,
                                uv_max_out.data + 2 * slot, xyz_min_out.data + 3 * slot,
                                xyz_max_out.data + 3 * slot, xyz_sum_out.data + 6 * slot,
                                a_out.data + 2 * slot, b_out.data + 2 * slot, c_out.data + 2 * slot,
                                bottom_top_out.data + 2 * slot, has_vertex_out.data + slot};
        Outlines outlines{cells, warp, measures, slots, settings.data[Outlines::LONG],
                          directions.data, contour_out.data + 2 * columns * slot,
                          contour_points_out.data + slot, direction_out.data + 2 * slot,
                          span_out.data + 4 * slot};
        cells.allocate(outlines.allocate(scratch), slots);
        outlines.run();
""",
)
def outlines(
    label: wp.array3d[wp.int32],  # (B, R, C) obstacles, -1 = none; C at most 512, R C at most 2^20
    count: wp.array[wp.int32],  # (B,) how many there are; those from M on are left out
    x: wp.array3d[wp.int32],  # (B, R, C) depth optical frame [depth units]
    y: wp.array3d[wp.int32],
    z: wp.array3d[wp.int32],
    right: wp.array3d[wp.int32],  # (B, R, C) on the floor [depth units]
    forward: wp.array3d[wp.int32],
    height: wp.array3d[wp.int32],  # above the floor [depth units]
    corner_x: wp.array2d[wp.float32],  # (R + 1, C + 1) rays of the cells' corners; not if aligned
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],  # of the projection into the colour image; not if aligned
    last: wp.array[wp.int32],  # (2,) last column and row of the image of boxes
    side: int,  # of a cell [depth pixel]
    model: int,  # the colour camera's lens
    aligned: int,  # 1 where boxes are in the depth image
    bands: wp.array2d[wp.int32],  # (65536, 2) see jaxdet.floor.plane.band_table
    directions: wp.array2d[wp.int32],  # (90, 2) see jaxdet.floor.plane.direction_table
    settings: wp.array[wp.int32],  # (3,) see native/outlines.h
    num_points_out: wp.array2d[wp.int32],  # (B, M, ...) from here on as jaxdet.types.Obstacles
    uv_min_out: wp.array3d[wp.int32],
    uv_max_out: wp.array3d[wp.int32],
    xyz_min_out: wp.array3d[wp.int32],
    xyz_max_out: wp.array3d[wp.int32],
    xyz_sum_out: wp.array4d[wp.int32],
    a_out: wp.array3d[wp.int32],
    b_out: wp.array3d[wp.int32],
    c_out: wp.array3d[wp.int32],
    has_vertex_out: wp.array2d[wp.bool],
    direction_out: wp.array3d[wp.int32],
    span_out: wp.array3d[wp.int32],
    contour_out: wp.array4d[wp.int32],  # (B, M, C, 2) right and forward by column, then zeros
    contour_points_out: wp.array2d[wp.int32],  # (B, M) how many points of it are used
    bottom_top_out: wp.array3d[wp.int32],  # (B, M, 2) lowest and highest cell above the floor
):
    """``scratch_words`` of scratch memory."""
