"""Cells on the floor and in surfaces. Twin of ``jaxdet/reference/_surfaces.py``."""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, native_kernel

wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})


def surfaces_words(rows: int, columns: int) -> int:
    """Words of scratch memory that a team needs for frames of so many cells."""
    cells, grid = rows * columns, (rows + 2) * (columns + 16) + 16
    words = 1 << (-(-columns // 32) - 1).bit_length()
    return 3 * grid + 6 * cells + 32 + 5 * rows * words


@native_kernel(
    "bits.h",
    "floor_frame.h",
    "grid.h",
    "lanes.h",
    "scan.h",
    "runs.h",
    "shared_words.h",
    "creases.h",
    "surfaces.h",
    body="""
    const Team team(tid, share);
    const int batch = z.shape[0], rows = z.shape[1], columns = z.shape[2];
    for (int b = team.index; b < batch; b += shares) {
        const size_t at = (size_t)b * rows * columns;
        Surfaces surfaces = {rows, columns, x.data + at, y.data + at, z.data + at};
        surfaces.floor = floor.data + b * FloorFrame::VALUES;
        surfaces.steps = steps.data;
        surfaces.limits = limits.data;
        surfaces.rises = rises.data;
        surfaces.settings = settings.data;
        surfaces.right = right_out.data + at;
        surfaces.forward = forward_out.data + at;
        surfaces.height = height_out.data + at;
        surfaces.label_out = label_out.data + at;
        surfaces.keep = (unsigned char*)keep_out.data + at;
        surfaces.free = (unsigned char*)free_out.data + at;
        surfaces.low = (unsigned char*)low_out.data + at;
        surfaces.count_out = count_out.data + b;
        surfaces.scratch = scratch_out.data + (size_t)team.index * scratch_out.shape[1];
        surfaces.run(team);
    }
""",
)
def surfaces(
    tid: int,
    share: int,
    shares: int,
    x: wp.array3d[wp.int32],
    y: wp.array3d[wp.int32],
    z: wp.array3d[wp.int32],
    floor: wp.array2d[wp.int32],
    steps: wp.array[wp.int32],
    limits: wp.array[wp.int32],
    rises: wp.array[wp.int32],
    settings: wp.array[wp.int32],
    right_out: wp.array3d[wp.int32],
    forward_out: wp.array3d[wp.int32],
    height_out: wp.array3d[wp.int32],
    label_out: wp.array3d[wp.int32],
    keep_out: wp.array3d[wp.bool],
    free_out: wp.array3d[wp.bool],
    low_out: wp.array3d[wp.bool],
    count_out: wp.array[wp.int32],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        tid: Of the launch.
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        x: ``(B, R, C)``, colour optical frame [depth units]; at most 512 rows and columns.
        y: Likewise.
        z: Likewise, 0 .. 65535, 0 = no measurement.
        floor: ``(B, 13)``, see ``native/floor_frame.h``.
        steps: ``(65536,)``, largest step in depth between neighbours of a surface, by z; at most
            2^16.
        limits: ``(65536,)``, deeper bends are creases, by z; at most 2^17.
        rises: ``(65536,)``, what is no higher above the floor is floor, by z.
        settings: ``(6,)``, see :class:`jaxdet.stages._surfaces.SurfaceSettings`.
        right_out: ``(B, R, C)``, on the floor [depth units].
        forward_out: Likewise.
        height_out: Above the floor, ramps included.
        label_out: ``(B, R, C)``, surfaces in the order of their first cell; -1 = none, or beyond
            the 512th.
        keep_out: ``(B, R, C)``, in range and above the floor.
        free_out: ``(B, R, C)``, measured to be free: floor, or beyond the range.
        low_out: ``(B, R, C)``, measured and no higher than the step.
        count_out: ``(B,)``, how many surfaces there are, those without a label included.
        scratch_out: ``(teams, surfaces_words(R, C))``.
    """
