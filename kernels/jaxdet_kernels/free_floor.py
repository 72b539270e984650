"""Free floor: how far it is seen, column by column. Twin of ``jaxdet/reference/_free.py``."""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, native_kernel

wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})

COLUMN_WORDS = 8


def scratch_words(columns: int) -> int:
    """32-bit words of scratch memory of a team, for so many columns of cells."""
    return COLUMN_WORDS * columns


@native_kernel(
    "free_floor.h",
    body="""
    const Team team(tid, share);
    const int batch = label.shape[0], rows = label.shape[1], columns = label.shape[2];
    FreeFloor floor(team);
    floor.rows = rows;
    floor.columns = columns;
    floor.far = settings.data[FreeFloor::FAR];
    floor.gap = settings.data[FreeFloor::GAP];
    floor.bows = bows.data;
    floor.drops = drops.data;
    int* scratch = scratch_out.data + (size_t)team.index * scratch_out.shape[1];
    floor.lay(scratch);
    for (int b = team.index; b < batch; b += shares) {
        const size_t at = (size_t)b * rows * columns, column = (size_t)b * columns;
        floor.label = label.data + at;
        floor.low = low.data + at;
        floor.z = z.data + at;
        floor.right = right.data + at;
        floor.forward = forward.data + at;
        floor.height = height.data + at;
        floor.line_out = free_out.data + 4 * column;
        floor.end_out = free_end_out.data + column;
        floor.run();
    }
""",
)
def free_floor(
    tid: int,
    share: int,
    shares: int,
    label: wp.array3d[wp.int32],
    low: wp.array3d[wp.bool],
    z: wp.array3d[wp.int32],
    right: wp.array3d[wp.int32],
    forward: wp.array3d[wp.int32],
    height: wp.array3d[wp.int32],
    bows: wp.array[wp.int32],
    drops: wp.array[wp.int32],
    settings: wp.array[wp.int32],
    free_out: wp.array4d[wp.int32],
    free_end_out: wp.array2d[wp.int32],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        tid: Of the launch.
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        label: ``(B, R, C)`` obstacles, -1 = none.
        low: ``(B, R, C)``, measured and no higher than the step.
        z: ``(B, R, C)``, colour optical frame [depth units], from 0 to 65535.
        right: ``(B, R, C)``, on the floor [depth units].
        forward: Likewise.
        height: Above the floor [depth units].
        bows: ``(65536,)``, how far below the plane floor still is, by z [depth units].
        drops: ``(65536,)``, how much lower what lies behind an edge is, by z [depth units].
        settings: ``(2,)``, see :class:`jaxdet.stages._free.FreeSettings`.
        free_out: ``(B, C, 2, 2)``, where the free floor begins and where it ends.
        free_end_out: ``(B, C)``, see :class:`jaxdet.types.FreeEnd`.
        scratch_out: ``(teams, scratch_words)``.
    """
