"""Stage align: depth pixels moved into the colour image. Twin of ``jaxdet/reference/_align.py``.

Compiled without fused multiply-add, so that every operation is rounded on its own.
"""

import warp as wp

from jaxdet_kernels.native_source import native

wp.set_module_options(
    {"fuse_fp": False, "enable_backward": False, "cpu_compiler_flags": "-march=native"}
)

PINHOLE, PLUMB_BOB, RATIONAL, EQUIDISTANT = 0, 1, 2, 3
"""Lens models, by number."""

PARAMETERS = 26
"""Length of ``parameters``, see ``native/projection.h``."""

TILE_BLOCK, TILE_ROWS, TILE_COLUMNS = 256, 16, 32
"""Threads of a block on CUDA, and its tile of the depth image; see ``native/alignment.h``."""

SPARE = 20
"""Keys behind each image and line on the CPU, likewise."""


def lines_words(height: int, width: int) -> int:
    """Words of scratch memory of a frame on the CPU: an image of keys and 4 lines."""
    return height * width + SPARE + 4 * (width + SPARE)


@wp.func_native(
    native(
        "projection.h",
        "alignment.h",
        body="""
#if !defined(__CUDA_ARCH__)
    const int rows = depth.shape[1], columns = depth.shape[2];
    const int height = depth_out.shape[1], width = depth_out.shape[2];
    unsigned* keys = scratch_out.data + (size_t)share * scratch_out.shape[1];
    unsigned* lines = keys + (size_t)height * width + Alignment::SPARE;
    const size_t at = (size_t)b * height * width;
    Alignment{depth.data + (size_t)b * rows * columns, rows, columns, corner_x.data, corner_y.data,
              {parameters.data, model}, fills, height, width, keys}
        .run(lines, depth_out.data + at, z_out.data + at);
#endif
""",
    )
)
def _lines(
    b: int,
    share: int,
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    model: int,
    fills: int,
    depth_out: wp.array3d[wp.uint16],
    z_out: wp.array3d[wp.uint16],
    scratch_out: wp.array2d[wp.uint32],
): ...


@wp.kernel
def align_lines(
    share: int,
    shares: int,
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    model: int,
    fills: int,
    depth_out: wp.array3d[wp.uint16],
    z_out: wp.array3d[wp.uint16],
    scratch_out: wp.array2d[wp.uint32],
):
    """A thread a frame, ``share + shares * i``; for the CPU.

    Args:
        share: The first frame of the launch.
        shares: How many launches there are.
        depth: ``(B, Hd, Wd)`` [depth units], 0 = no measurement.
        corner_x: ``(Hd + 1, Wd + 1)``, the rays of the depth pixels' corners.
        corner_y: Likewise.
        parameters: ``(PARAMETERS,)``.
        model: The colour camera's lens.
        fills: 1 where a depth pixel covers all colour pixels between its corners, else 0.
        depth_out: ``(B, H, W)`` [depth units], 0 where nothing hits.
        z_out: Likewise, in the colour camera.
        scratch_out: ``(shares, lines_words(H, W))``.
    """
    b = share + shares * wp.tid()
    _lines(
        b, share, depth, corner_x, corner_y, parameters, model, fills, depth_out, z_out,
        scratch_out,
    )  # fmt: skip


@wp.func_native(
    native(
        "projection.h",
        "alignment.h",
        body="""
#if defined(__CUDA_ARCH__)
    const Team team(0, tile);
    const int rows = depth.shape[1], columns = depth.shape[2];
    const int height = keys_out.shape[1], width = keys_out.shape[2];
    const int down = (rows + Alignment::TILE_ROWS - 1) / Alignment::TILE_ROWS;
    const int across = (columns + Alignment::TILE_COLUMNS - 1) / Alignment::TILE_COLUMNS;
    const int b = team.index / (down * across);
    Alignment{depth.data + (size_t)b * rows * columns, rows, columns, corner_x.data, corner_y.data,
              {parameters.data, model}, fills, height, width,
              keys_out.data + (size_t)b * height * width}
        .lower_by_tile(team, team.index % (down * across));
#endif
""",
    )
)
def _tile(
    tile: int,
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    model: int,
    fills: int,
    keys_out: wp.array3d[wp.uint32],
): ...


@wp.kernel
def align_tiles(
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    model: int,
    fills: int,
    keys_out: wp.array3d[wp.uint32],
):
    """A block a tile of a depth image; for CUDA.

    The arguments are those of :func:`align_lines`, but ``keys_out`` ``(B, H, W)`` comes with all
    bits set and is lowered to ``depth << 16 | z``.
    """
    tile, _ = wp.tid()
    _tile(tile, depth, corner_x, corner_y, parameters, model, fills, keys_out)
