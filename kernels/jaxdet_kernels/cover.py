"""Colour pixels under kept cells, and corners on them. Twin of ``cover`` in the reference."""

import warp as wp

from jaxdet_kernels.native_source import native

wp.set_module_options({"enable_backward": False})


def cover_scratch(height: int, width: int, slots: int) -> int:
    """Words of scratch memory that :func:`cover_corners` takes."""
    return 3 * slots + height * (-(-width // 32) + 1)


_COVER = """
    const Team team(tid, share);
    const int cells = z.shape[1] * z.shape[2];
    for (int b = team.index; b < z.shape[0]; b += shares) {
        const size_t i = (size_t)b * cells;
        const Cover cover{team, height, width, cells, keep.data + i, z.data + i,
                          uv_min.data + 2 * i, uv_max.data + 2 * i};
"""


@wp.func_native(
    native(
        "cover.h",
        body=_COVER
        + """
        cover.paint(mask_out.data + (size_t)b * height * width);
    }
""",
    )
)
def _cover_mask(
    tid: int,
    share: int,
    shares: int,
    keep: wp.array3d[wp.bool],
    z: wp.array3d[wp.int32],
    uv_min: wp.array4d[wp.int32],
    uv_max: wp.array4d[wp.int32],
    height: int,
    width: int,
    mask_out: wp.array3d[wp.bool],
): ...


@wp.kernel(launch_bounds=(256, 4))
def cover_mask(
    share: int,
    shares: int,
    keep: wp.array3d[wp.bool],
    z: wp.array3d[wp.int32],
    uv_min: wp.array4d[wp.int32],
    uv_max: wp.array4d[wp.int32],
    mask_out: wp.array3d[wp.bool],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        keep: ``(B, R, C)``, the cells that take part, all of them in view.
        z: ``(B, R, C)`` [depth units].
        uv_min: ``(B, R, C, 2)``, first colour column and row.
        uv_max: Last.
        mask_out: ``(B, H, W)``, under a kept cell.
        scratch_out: Not used.
    """
    _cover_mask(
        wp.tid(), share, shares, keep, z, uv_min, uv_max,
        mask_out.shape[1], mask_out.shape[2], mask_out,
    )  # fmt: skip


@wp.func_native(
    native(
        "cover.h",
        body=_COVER
        + """
        const int slots = u.shape[1];
        const size_t at = (size_t)b * slots;
        CoveredCorners{cover, count.data[b] < slots ? count.data[b] : slots, slots,
                       u.data + at, v.data + at,
                       scratch_out.data + (size_t)team.index * scratch_out.shape[1],
                       cell_out.data + at}.run();
        team.sync();
    }
""",
    )
)
def _cover_corners(
    tid: int,
    share: int,
    shares: int,
    keep: wp.array3d[wp.bool],
    z: wp.array3d[wp.int32],
    uv_min: wp.array4d[wp.int32],
    uv_max: wp.array4d[wp.int32],
    u: wp.array2d[wp.int32],
    v: wp.array2d[wp.int32],
    count: wp.array[wp.int32],
    height: int,
    width: int,
    cell_out: wp.array2d[wp.int32],
    scratch_out: wp.array2d[wp.int32],
): ...


@wp.kernel(launch_bounds=(256, 4))
def cover_corners(
    share: int,
    shares: int,
    keep: wp.array3d[wp.bool],
    z: wp.array3d[wp.int32],
    uv_min: wp.array4d[wp.int32],
    uv_max: wp.array4d[wp.int32],
    u: wp.array2d[wp.int32],
    v: wp.array2d[wp.int32],
    count: wp.array[wp.int32],
    height: int,
    width: int,
    cell_out: wp.array2d[wp.int32],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        keep: ``(B, R, C)``, the cells that take part, all of them in view.
        z: ``(B, R, C)`` [depth units].
        uv_min: ``(B, R, C, 2)``, first colour column and row.
        uv_max: Last.
        u: ``(B, N)``, the corners' columns.
        v: Rows.
        count: ``(B,)``, how many corners are used, or more than N.
        height: Of the colour image.
        width: Likewise.
        cell_out: ``(B, N)``, the nearest cell over each corner, of equally near ones the first; -1
            where there is none.
        scratch_out: ``(teams, cover_scratch)``.
    """
    _cover_corners(
        wp.tid(), share, shares, keep, z, uv_min, uv_max, u, v, count, height, width,
        cell_out, scratch_out,
    )  # fmt: skip
