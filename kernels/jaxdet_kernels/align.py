"""Stage align: depth pixels moved into the colour image. Twin of ``jaxdet/reference/_align.py``.

Compiled without fused multiply-add, so that every operation is rounded on its own.
"""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, native_kernel

wp.set_module_options({"fuse_fp": False, "enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})

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


@native_kernel(
    "projection.h",
    "image_tile.h",
    "alignment.h",
    body="""
#if !defined(__CUDA_ARCH__)
    const int rows = depth.shape[1], columns = depth.shape[2];
    const int height = depth_out.shape[1], width = depth_out.shape[2];
    const size_t size = (size_t)height * width, b = share + shares * tid;
    unsigned* keys = scratch_out.data + (size_t)share * scratch_out.shape[1];
    Alignment{depth.data + b * rows * columns, rows, columns, corner_x.data, corner_y.data,
              {parameters.data, model}, fills, height, width, keys}
        .run(keys + size + Alignment::SPARE, depth_out.data + b * size, z_out.data + b * size);
#endif
""",
)
def align_lines(
    tid: int,
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
        tid: Of the launch.
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


@native_kernel(
    "projection.h",
    "image_tile.h",
    "alignment.h",
    body="""
#if defined(__CUDA_ARCH__)
    const Team team(0, blockIdx.x);  // of large batches tid has more than 31 bits
    const int rows = depth.shape[1], columns = depth.shape[2];
    const int height = keys_out.shape[1], width = keys_out.shape[2];
    const ImageTile at(team, Alignment::TILE_ROWS, Alignment::TILE_COLUMNS, rows, columns);
    Alignment{depth.data + (size_t)at.image * rows * columns, rows, columns, corner_x.data,
              corner_y.data, {parameters.data, model}, fills, height, width,
              keys_out.data + (size_t)at.image * height * width}.lower_by_tile(team, at);
#endif
""",
    launch_bounds=(TILE_BLOCK, 1),
)
def align_tiles(
    tid: int,
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
