"""Features on cells: twin of the reference's ``cover`` and ``_points``.

Bits are laid out as ``pixel_bits.h`` says: ``words`` 32-bit words a row, an even number.
"""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, includes, team_kernel

wp.set_module_options(
    {
        "enable_backward": False,
        "cpu_compiler_flags": CPU_FLAGS,
        "extra_build_options": includes("cover.h"),
    }
)


TILE = 8  # rows and columns of a tile of cover.h


def cover_scratch(height: int, width: int, slots: int) -> int:
    """Words of scratch memory that :func:`cover_features` takes."""
    return 3 * slots + -(-height // TILE) * -(-width // TILE)


_COVER = """
        const int cells = z.shape[1] * z.shape[2];
        const size_t i = (size_t)b * cells;
        const Cover cover{team, height, width, cells, keep.data + i, in_view.data + i, z.data + i,
                          (const int*)uv_min.data + i, (const int*)uv_max.data + i,
                          depth_range.data, num_taken.data + b, taken.data + i};
"""


@team_kernel(
    body="""
        auto &num_taken = num_taken_out, &taken = taken_out;
"""
    + _COVER
    + """
        const bool has_depth =
            CoverMask{cover, mask_out.data + (size_t)b * height * PixelBits::words(width)}.run();
        if (team.rank == 0) has_depth_out.data[b] = has_depth;
        team.sync();
""",
)
def cover_mask(
    keep: wp.array3d[wp.bool],  # (B, R, C) cells that take part if in view and not too far
    in_view: wp.array3d[wp.bool],  # (B, R, C)
    z: wp.array3d[wp.int32],  # (B, R, C) [depth units]
    uv_min: wp.array4d[wp.int16],  # (B, R, C, 2) first colour column and row
    uv_max: wp.array4d[wp.int16],  # last
    depth_range: wp.array[wp.int32],  # (2,) least and largest depth [depth units]
    height: int,  # of the colour image
    width: int,
    mask_out: wp.array3d[wp.uint32],  # (B, H, words) under a cell that takes part
    has_depth_out: wp.array[wp.bool],  # (B,) some cell in view is in range
    num_taken_out: wp.array[wp.int32],  # (B,) how many cells take part
    taken_out: wp.array2d[wp.int32],  # (B, R C) which, in no order
):
    """Where corners may be."""


@team_kernel(
    body="""
        const int height = ray_x.shape[0], width = ray_x.shape[1], slots = u.shape[1];
"""
    + _COVER
    + """
        const size_t at = (size_t)b * slots, to = (size_t)b * u_out.shape[1];
        const FeatureSlots out{u_out.data + to, v_out.data + to, x_out.data + to, y_out.data + to,
                               z_out.data + to, label_out.data + to, valid_out.data + to,
                               kept_out.data + to, most};
        SampledCells{cover, z.shape[1], z.shape[2], x.data + i, y.data + i, label.data + i, out,
                     slots}.run();
        CoveredCorners{cover, count.data[b] < slots ? count.data[b] : slots, slots, u.data + at,
                       v.data + at, scratch, label.data + i, ray_x.data, ray_y.data, out}.run();
        team.sync();
""",
)
def cover_features(
    keep: wp.array3d[wp.bool],  # as in cover_mask, and so are the next ones
    in_view: wp.array3d[wp.bool],
    z: wp.array3d[wp.int32],
    uv_min: wp.array4d[wp.int16],
    uv_max: wp.array4d[wp.int16],
    depth_range: wp.array[wp.int32],
    num_taken: wp.array[wp.int32],
    taken: wp.array2d[wp.int32],
    x: wp.array3d[wp.int32],  # (B, R, C) colour optical frame [depth units]
    y: wp.array3d[wp.int32],
    label: wp.array3d[wp.int32],  # (B, R, C) -1 = none
    most: int,  # labels from here on become -1
    ray_x: wp.array2d[wp.int32],  # (H, W) of the colour camera, see jaxdet.camera.fixed_rays
    ray_y: wp.array2d[wp.int32],
    u: wp.array2d[wp.int32],  # (B, N) the corners' columns
    v: wp.array2d[wp.int32],  # rows
    count: wp.array[wp.int32],  # (B,) how many corners are used, or more than N
    u_out: wp.array2d[wp.int32],  # (B, N + S) columns: of corners, of the middles of sampled cells
    v_out: wp.array2d[wp.int32],  # rows
    x_out: wp.array2d[wp.int32],  # coordinates [depth units], 0 where there are none
    y_out: wp.array2d[wp.int32],
    z_out: wp.array2d[wp.int32],
    label_out: wp.array2d[wp.int32],  # of the cell, if it is in view; or -1
    valid_out: wp.array2d[wp.bool],  # the slot has a corner; the cell is kept and in view
    kept_out: wp.array2d[wp.bool],  # a cell that takes part is over the corner; likewise
):
    """Corners, then every second cell of every second row.

    A corner has the depth of the nearest cell over it that takes part, of equally near ones of the
    first. ``cover_scratch`` of scratch memory.
    """
