"""Obstacles measured and outlined on all of their cells.

Twin of ``jaxdet/reference/_outlines.py`` and of ``footprint_on_floor`` beside it.
"""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, native_kernel

wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})

DIRECTIONS = 90
PARTS = 4


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


@native_kernel(
    "lanes.h",
    "bits.h",
    "listed.h",
    "obstacle_cells.h",
    "pixel_pair.h",
    "ranks.h",
    "measures.h",
    "outlines.h",
    body="""
    const Team team(tid, share);
    const Lanes lanes(team);
    const int batch = label.shape[0], columns = label.shape[2], grid = label.shape[1] * columns;
    const int slots = num_points_out.shape[1], capacity = contour_out.shape[2];
    for (int b = team.index; b < batch; b += shares) {
        const size_t at = (size_t)b * grid, slot = (size_t)b * slots;
        const int found = count.data[b] < slots ? count.data[b] : slots;

        ObstacleCells cells(team, grid, columns, found);
        cells.label = label.data + at;
        cells.right = right.data + at;
        cells.forward = forward.data + at;
        cells.in_view = in_view.data + at;

        Measures measures(cells, lanes);
        measures.trim = settings.data[Outlines::TRIM];
        measures.threshold = settings.data[Outlines::VERTEX];
        measures.bands = bands.data;
        measures.xyz[0] = x.data + at;
        measures.xyz[1] = y.data + at;
        measures.xyz[2] = z.data + at;
        measures.height = height.data + at;
        measures.uv_min = (const int*)uv_min.data + at;
        measures.uv_max = (const int*)uv_max.data + at;
        measures.count_out = num_points_out.data + slot;
        measures.uv_min_out = uv_min_out.data + 2 * slot;
        measures.uv_max_out = uv_max_out.data + 2 * slot;
        measures.xyz_min_out = xyz_min_out.data + 3 * slot;
        measures.xyz_max_out = xyz_max_out.data + 3 * slot;
        measures.xyz_sum_out = xyz_sum_out.data + 6 * slot;
        measures.a_out = a_out.data + 2 * slot;
        measures.b_out = b_out.data + 2 * slot;
        measures.c_out = c_out.data + 2 * slot;
        measures.bottom_top_out = bottom_top_out.data + 2 * slot;
        measures.vertex_out = has_vertex_out.data + slot;

        Outlines outlines(cells, lanes, measures);
        outlines.slots = slots;
        outlines.capacity = capacity;
        outlines.longest = settings.data[Outlines::LONG];
        outlines.directions = directions.data;
        outlines.contour_out = contour_out.data + 2 * capacity * slot;
        outlines.points_out = contour_points_out.data + slot;
        outlines.direction_out = direction_out.data + 2 * slot;
        outlines.span_out = span_out.data + 4 * slot;

        int* scratch = scratch_out.data + (size_t)team.index * scratch_out.shape[1];
        cells.lay(outlines.lay(scratch), slots);
        outlines.run();
    }
""",
)
def outlines(
    tid: int,
    share: int,
    shares: int,
    label: wp.array3d[wp.int32],
    count: wp.array[wp.int32],
    x: wp.array3d[wp.int32],
    y: wp.array3d[wp.int32],
    z: wp.array3d[wp.int32],
    right: wp.array3d[wp.int32],
    forward: wp.array3d[wp.int32],
    height: wp.array3d[wp.int32],
    in_view: wp.array3d[wp.bool],
    uv_min: wp.array4d[wp.int16],
    uv_max: wp.array4d[wp.int16],
    bands: wp.array2d[wp.int32],
    directions: wp.array2d[wp.int32],
    settings: wp.array[wp.int32],
    num_points_out: wp.array2d[wp.int32],
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
    contour_out: wp.array4d[wp.int32],
    contour_points_out: wp.array2d[wp.int32],
    bottom_top_out: wp.array3d[wp.int32],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        tid: Of the launch.
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        label: ``(B, R, C)`` obstacles, -1 = none; at most 512 columns and 2^20 cells.
        count: ``(B,)``, how many there are; those from M on are left out.
        x: ``(B, R, C)``, colour optical frame [depth units].
        y: Likewise.
        z: Likewise.
        right: ``(B, R, C)``, on the floor [depth units].
        forward: Likewise.
        height: Above the floor [depth units].
        in_view: ``(B, R, C)``, at least partly in the colour image.
        uv_min: ``(B, R, C, 2)``, the first colour column and row of a cell [pixel].
        uv_max: The last.
        bands: ``(65536, 2)``, see :func:`jaxdet.floor.plane.band_table`.
        directions: ``(90, 2)``, see :func:`jaxdet.floor.plane.direction_table`.
        settings: ``(3,)``, see :class:`jaxdet.stages._outlines.OutlineSettings`.
        num_points_out: ``(B, M)``, this and those up to ``span_out`` the fields of
            :class:`jaxdet.types.Obstacles`.
        uv_min_out: ``(B, M, 2)``.
        uv_max_out: Likewise.
        xyz_min_out: ``(B, M, 3)``.
        xyz_max_out: Likewise.
        xyz_sum_out: ``(B, M, 3, 2)``.
        a_out: ``(B, M, 2)``.
        b_out: Likewise.
        c_out: Likewise.
        has_vertex_out: ``(B, M)``.
        direction_out: ``(B, M, 2)``.
        span_out: ``(B, M, 4)``.
        contour_out: ``(B, M, C, 2)``, right and forward from left to right, then zeros.
        contour_points_out: ``(B, M)``, how many points of it are used.
        bottom_top_out: ``(B, M, 2)``, lowest and highest cell above the floor.
        scratch_out: ``(teams, scratch_words)``.
    """
