"""Cells on the floor and in surfaces. Twin of ``jaxdet/reference/_surfaces.py``."""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, bit_words, team_kernel

wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})


def surfaces_words(rows: int, columns: int) -> int:
    """Words of scratch memory that a team needs for frames of so many cells."""
    cells, grid = rows * columns, (rows + 2) * (columns + 16) + 16
    return 3 * grid + 6 * cells + 5 * bit_words(rows, columns) + 1


@team_kernel(
    "surfaces.h",
    body="""
        const size_t at = (size_t)b * z.shape[1] * z.shape[2];
        Surfaces{z.shape[1], z.shape[2], x.data + at, y.data + at, z.data + at,
                 floor.data + b * FloorFrame::VALUES, steps.data, limits.data, rises.data,
                 settings.data, right_out.data + at, forward_out.data + at, height_out.data + at,
                 label_out.data + at, (unsigned char*)keep_out.data + at,
                 (unsigned char*)free_out.data + at, (unsigned char*)low_out.data + at,
                 count_out.data + b, has_depth_out.data + b, scratch}.run(team);
""",
)
def surfaces(
    x: wp.array3d[wp.int32],  # (B, R, C) depth optical frame [depth units]; R, C at most 512
    y: wp.array3d[wp.int32],
    z: wp.array3d[wp.int32],  # 0 .. 65535, 0 = no measurement
    floor: wp.array2d[wp.int32],  # (B, 13) see native/floor_frame.h
    steps: wp.array[wp.int32],  # (65536,) by z, largest step between neighbours, at most 2^16
    limits: wp.array[wp.int32],  # (65536,) by z, deeper bends are creases, at most 2^17
    rises: wp.array[wp.int32],  # (65536,) by z, what is no higher above the floor is floor
    settings: wp.array[wp.int32],  # (9,) see native/surfaces.h
    right_out: wp.array3d[wp.int32],  # (B, R, C) on the floor [depth units]
    forward_out: wp.array3d[wp.int32],
    height_out: wp.array3d[wp.int32],  # above the floor, ramps included
    label_out: wp.array3d[wp.int32],  # by their first cell; -1 = none, or beyond the 512th
    keep_out: wp.array3d[wp.bool],  # in range and above the floor
    free_out: wp.array3d[wp.bool],  # measured to be free: floor, or beyond the range
    low_out: wp.array3d[wp.bool],  # measured and no higher than the step
    count_out: wp.array[wp.int32],  # (B,) how many surfaces, those without a label included
    has_depth_out: wp.array[wp.bool],  # (B,) some depth is in range
):
    """``surfaces_words`` of scratch memory."""
