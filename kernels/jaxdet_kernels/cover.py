"""Masks of the colour image as bits, and features on cells: twin of ``cover`` and ``_points``.

Bits are laid out as ``native/pixel_bits.h`` says: ``words`` 32-bit words a row, an even number.
"""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, native_kernel

wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})


TILE = 8
"""Rows and columns of a tile of ``native/cover.h``."""


def cover_scratch(height: int, width: int, slots: int) -> int:
    """Words of scratch memory that :func:`cover_features` takes."""
    return 3 * slots + -(-height // TILE) * -(-width // TILE)


_COVER = """
    const Team team(tid, share);
    const int cells = z.shape[1] * z.shape[2];
    for (int b = team.index; b < z.shape[0]; b += shares) {
        const size_t i = (size_t)b * cells;
        const Cover cover{team, height, width, cells, keep.data + i, in_view.data + i, z.data + i,
                          (const int*)uv_min.data + i, (const int*)uv_max.data + i,
                          depth_range.data, num_taken.data + b, taken.data + i};
"""


@native_kernel(
    "vectors.h",
    "pixel_bits.h",
    "mask_bits.h",
    body="""
    const Team team(tid, share);
    const int height = mask.shape[1], width = mask.shape[2];
    const size_t words = (size_t)height * PixelBits::words(width);
    for (int b = team.index; b < mask.shape[0]; b += shares)
        MaskBits{team, height, width, mask.data + (size_t)b * height * width,
                 bits_out.data + b * words}.run();
""",
)
def mask_bits(
    tid: int,
    share: int,
    shares: int,
    mask: wp.array3d[wp.bool],
    bits_out: wp.array3d[wp.uint32],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        tid: Of the launch.
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        mask: ``(B, H, W)``.
        bits_out: ``(B, H, words)``.
        scratch_out: Not used.
    """


@native_kernel(
    "bits.h",
    "lanes.h",
    "pixel_bits.h",
    "pixel_pair.h",
    "cover.h",
    body="""
    auto &num_taken = num_taken_out, &taken = taken_out;
"""
    + _COVER
    + """
        const bool has_depth =
            CoverMask{cover, mask_out.data + (size_t)b * height * PixelBits::words(width)}.run();
        if (team.rank == 0) has_depth_out.data[b] = has_depth;
        team.sync();
    }
""",
)
def cover_mask(
    tid: int,
    share: int,
    shares: int,
    keep: wp.array3d[wp.bool],
    in_view: wp.array3d[wp.bool],
    z: wp.array3d[wp.int32],
    uv_min: wp.array4d[wp.int16],
    uv_max: wp.array4d[wp.int16],
    depth_range: wp.array[wp.int32],
    height: int,
    width: int,
    mask_out: wp.array3d[wp.uint32],
    has_depth_out: wp.array[wp.bool],
    num_taken_out: wp.array[wp.int32],
    taken_out: wp.array2d[wp.int32],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        tid: Of the launch.
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        keep: ``(B, R, C)``, the cells that take part if they are in view and no farther than the
            range.
        in_view: ``(B, R, C)``.
        z: ``(B, R, C)`` [depth units].
        uv_min: ``(B, R, C, 2)``, first colour column and row.
        uv_max: Last.
        depth_range: ``(2,)``, least and largest depth [depth units].
        height: Of the colour image.
        width: Likewise.
        mask_out: ``(B, H, words)``, under a cell that takes part.
        has_depth_out: ``(B,)``, some cell in view is in range.
        num_taken_out: ``(B,)``, how many cells take part.
        taken_out: ``(B, R C)``, which, in no order.
        scratch_out: Not used.
    """


@native_kernel(
    "bits.h",
    "lanes.h",
    "pixel_bits.h",
    "pixel_pair.h",
    "cover.h",
    body="""
    const int height = ray_x.shape[0], width = ray_x.shape[1];
"""
    + _COVER
    + """
        const int slots = u.shape[1];
        int* scratch = scratch_out.data + (size_t)team.index * scratch_out.shape[1];
        const size_t at = (size_t)b * slots, to = (size_t)b * u_out.shape[1];
        const FeatureSlots out{u_out.data + to, v_out.data + to, x_out.data + to, y_out.data + to,
                               z_out.data + to, label_out.data + to, valid_out.data + to,
                               kept_out.data + to, most};
        SampledCells{cover, z.shape[1], z.shape[2], x.data + i, y.data + i, label.data + i, out,
                     slots}.run();
        CoveredCorners{cover, count.data[b] < slots ? count.data[b] : slots, slots,
                       u.data + at, v.data + at, scratch, label.data + i, ray_x.data, ray_y.data,
                       out}.run();
        team.sync();
    }
""",
)
def cover_features(
    tid: int,
    share: int,
    shares: int,
    keep: wp.array3d[wp.bool],
    in_view: wp.array3d[wp.bool],
    z: wp.array3d[wp.int32],
    uv_min: wp.array4d[wp.int16],
    uv_max: wp.array4d[wp.int16],
    depth_range: wp.array[wp.int32],
    num_taken: wp.array[wp.int32],
    taken: wp.array2d[wp.int32],
    x: wp.array3d[wp.int32],
    y: wp.array3d[wp.int32],
    label: wp.array3d[wp.int32],
    most: int,
    ray_x: wp.array2d[wp.int32],
    ray_y: wp.array2d[wp.int32],
    u: wp.array2d[wp.int32],
    v: wp.array2d[wp.int32],
    count: wp.array[wp.int32],
    u_out: wp.array2d[wp.int32],
    v_out: wp.array2d[wp.int32],
    x_out: wp.array2d[wp.int32],
    y_out: wp.array2d[wp.int32],
    z_out: wp.array2d[wp.int32],
    label_out: wp.array2d[wp.int32],
    valid_out: wp.array2d[wp.bool],
    kept_out: wp.array2d[wp.bool],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        tid: Of the launch.
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        keep: As in :func:`cover_mask`, and so are the next ones.
        in_view: ``(B, R, C)``.
        z: ``(B, R, C)``.
        uv_min: ``(B, R, C, 2)``.
        uv_max: Likewise.
        depth_range: ``(2,)``.
        num_taken: ``(B,)``, from :func:`cover_mask`.
        taken: ``(B, R C)``, likewise.
        x: ``(B, R, C)``, colour optical frame [depth units].
        y: Likewise.
        label: ``(B, R, C)``, -1 = none.
        most: Labels from here on become -1.
        ray_x: ``(H, W)``, of the colour camera, see :func:`jaxdet.camera.fixed_rays`.
        ray_y: Likewise.
        u: ``(B, N)``, the corners' columns.
        v: Rows.
        count: ``(B,)``, how many corners are used, or more than N.
        u_out: ``(B, N + S)``, columns: of the corners, then of the middle of every second cell of
            every second row.
        v_out: Rows.
        x_out: Coordinates [depth units]. A corner has the depth of the nearest cell over it that
            takes part, of equally near ones of the first; 0 where there is none.
        y_out: Likewise.
        z_out: Likewise.
        label_out: Of that cell, if it is in view; or -1.
        valid_out: The slot has a corner; the cell is kept and in view.
        kept_out: The corner has such a cell; likewise.
        scratch_out: ``(teams, cover_scratch)``.
    """
