"""Free floor: how far it is seen, column by column. Twin of ``jaxdet/reference/_free.py``."""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, includes, team_kernel

wp.set_module_options(
    {
        "enable_backward": False,
        "cpu_compiler_flags": CPU_FLAGS,
        "extra_build_options": includes("free_floor.h"),
    }
)


@team_kernel(
    body="""
        const int rows = label.shape[1], columns = label.shape[2];
        const size_t at = (size_t)b * rows * columns, column = (size_t)b * columns;
        FreeFloor floor{team, rows, columns, settings.data[FreeFloor::FAR],
                        settings.data[FreeFloor::GAP], label.data + at, z.data + at,
                        right.data + at, forward.data + at, height.data + at, low.data + at,
                        bows.data, drops.data, free_out.data + 4 * column,
                        free_end_out.data + column, scratch, false};
        floor.run(FloorFrame(frame.data + b * FloorFrame::VALUES));
""",
)
def free_floor(
    label: wp.array3d[wp.int32],  # (B, R, C) obstacles, -1 = none
    low: wp.array3d[wp.bool],  # (B, R, C) measured and no higher than the step
    z: wp.array3d[wp.int32],  # (B, R, C) colour optical frame [depth units], from 0 to 65535
    right: wp.array3d[wp.int32],  # (B, R, C) on the floor [depth units]
    forward: wp.array3d[wp.int32],
    height: wp.array3d[wp.int32],  # above the floor [depth units]
    frame: wp.array2d[wp.int32],  # (B, 13) frames of floors
    bows: wp.array[wp.int32],  # (65536,) by z, how far below the plane floor still is
    drops: wp.array[wp.int32],  # (65536,) by z, how much lower what lies behind an edge is
    settings: wp.array[wp.int32],  # (2,) see free_floor.h
    free_out: wp.array4d[wp.int32],  # (B, C, 2, 2) where the free floor begins and where it ends
    free_end_out: wp.array2d[wp.int32],  # (B, C) jaxdet.types.FreeEnd
):
    """A word of scratch memory a column."""
