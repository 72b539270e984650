"""Masks of the colour image as bits, and corners on cells. Twin of ``cover`` in the reference.

Bits are laid out as ``native/pixel_bits.h`` says: ``words`` 32-bit words a row, an even number.
"""

import warp as wp

from jaxdet_kernels.native_source import native_kernel

wp.set_module_options({"enable_backward": False})


TILE = 8
"""Rows and columns of a tile of ``native/cover.h``."""


def mask_scratch(cells: int) -> int:
    """Words of scratch memory that :func:`cover_mask` takes."""
    return 1 + cells


def cover_scratch(cells: int, height: int, width: int, slots: int) -> int:
    """Words of scratch memory that :func:`cover_corners` takes."""
    return 3 * slots + -(-height // TILE) * -(-width // TILE) + mask_scratch(cells)


_COVER = """
    const Team team(tid, share);
    const int cells = z.shape[1] * z.shape[2];
    int* scratch = scratch_out.data + (size_t)team.index * scratch_out.shape[1];
    for (int b = team.index; b < z.shape[0]; b += shares) {
        const size_t i = (size_t)b * cells;
        const Cover cover{team, height, width, cells, keep.data + i, z.data + i,
                          uv_min.data + 2 * i, uv_max.data + 2 * i,
                          scratch + scratch_out.shape[1] - 1 - cells};
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
    "pixel_bits.h",
    "cover.h",
    body=_COVER
    + """
        cover.paint(mask_out.data + (size_t)b * height * PixelBits::words(width));
        team.sync();
    }
""",
)
def cover_mask(
    tid: int,
    share: int,
    shares: int,
    keep: wp.array3d[wp.bool],
    z: wp.array3d[wp.int32],
    uv_min: wp.array4d[wp.int32],
    uv_max: wp.array4d[wp.int32],
    height: int,
    width: int,
    mask_out: wp.array3d[wp.uint32],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        tid: Of the launch.
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        keep: ``(B, R, C)``, the cells that take part, all of them in view.
        z: ``(B, R, C)`` [depth units].
        uv_min: ``(B, R, C, 2)``, first colour column and row.
        uv_max: Last.
        height: Of the colour image.
        width: Likewise.
        mask_out: ``(B, H, words)``, under a kept cell.
        scratch_out: ``(teams, mask_scratch)``.
    """


@native_kernel(
    "pixel_bits.h",
    "cover.h",
    body="""
    const int height = ray_x.shape[0], width = ray_x.shape[1];
"""
    + _COVER
    + """
        const int slots = u.shape[1];
        const size_t at = (size_t)b * slots;
        CoveredCorners{cover, count.data[b] < slots ? count.data[b] : slots, slots,
                       u.data + at, v.data + at,
                       scratch, label.data + i, ray_x.data, ray_y.data, cell_out.data + at,
                       label_out.data + at, x_out.data + at, y_out.data + at,
                       z_out.data + at}.run();
        team.sync();
    }
""",
)
def cover_corners(
    tid: int,
    share: int,
    shares: int,
    keep: wp.array3d[wp.bool],
    z: wp.array3d[wp.int32],
    uv_min: wp.array4d[wp.int32],
    uv_max: wp.array4d[wp.int32],
    label: wp.array3d[wp.int32],
    ray_x: wp.array2d[wp.int32],
    ray_y: wp.array2d[wp.int32],
    u: wp.array2d[wp.int32],
    v: wp.array2d[wp.int32],
    count: wp.array[wp.int32],
    cell_out: wp.array2d[wp.int32],
    label_out: wp.array2d[wp.int32],
    x_out: wp.array2d[wp.int32],
    y_out: wp.array2d[wp.int32],
    z_out: wp.array2d[wp.int32],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        tid: Of the launch.
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        keep: ``(B, R, C)``, the cells that take part, all of them in view.
        z: ``(B, R, C)`` [depth units].
        uv_min: ``(B, R, C, 2)``, first colour column and row.
        uv_max: Last.
        label: ``(B, R, C)``.
        ray_x: ``(H, W)``, of the colour camera, see :func:`jaxdet.camera.fixed_rays`.
        ray_y: Likewise.
        u: ``(B, N)``, the corners' columns.
        v: Rows.
        count: ``(B,)``, how many corners are used, or more than N.
        cell_out: ``(B, N)``, the nearest cell over each corner, of equally near ones the first; -1
            where there is none.
        label_out: Its label, or -1.
        x_out: The corners' coordinates [depth units], or 0.
        y_out: Likewise.
        z_out: Likewise.
        scratch_out: ``(teams, cover_scratch)``.
    """
