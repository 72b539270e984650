"""Stage align: depth pixels moved into the colour image. Twin of ``jaxdet/reference/_align.py``.

Compiled without fused multiply-add, so that every operation is rounded on its own.
"""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, includes, native_kernel, team_kernel

wp.set_module_options(
    {
        "fuse_fp": False,
        "enable_backward": False,
        "cpu_compiler_flags": CPU_FLAGS,
        "extra_build_options": includes("alignment.h"),
    }
)

PARAMETERS = 26  # length of parameters, see projection.h

TILE_BLOCK, TILE_ROWS, TILE_COLUMNS = 256, 16, 32
"""Threads of a block on CUDA, and its tile of the depth image; see ``include/jaxdet/alignment.h``."""

SPARE = 20  # keys behind each image and line on the CPU, likewise


def lines_words(height: int, width: int) -> int:
    """Words of scratch memory of a frame on the CPU: an image of keys and 4 lines."""
    return height * width + SPARE + 4 * (width + SPARE)


@team_kernel(
    body="""
#if !defined(__CUDA_ARCH__)
        const int rows = depth.shape[1], columns = depth.shape[2];
        const int height = depth_out.shape[1], width = depth_out.shape[2];
        const size_t size = (size_t)height * width;
        unsigned* keys = (unsigned*)scratch;
        Alignment{depth.data + (size_t)b * rows * columns, rows, columns, corner_x.data,
                  corner_y.data, {parameters.data, model}, fills, height, width, keys}
            .run(keys + size + Alignment::SPARE, depth_out.data + b * size, z_out.data + b * size);
#endif
""",
)
def align_lines(
    depth: wp.array3d[wp.uint16],  # (B, Hd, Wd) [depth units], 0 = no measurement
    corner_x: wp.array2d[wp.float32],  # (Hd + 1, Wd + 1) rays of the depth pixels' corners
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],  # (PARAMETERS,)
    model: int,  # the colour camera's lens
    fills: int,  # 1 where a depth pixel covers all colour pixels between its corners, else 0
    depth_out: wp.array3d[wp.uint16],  # (B, H, W) [depth units], 0 where nothing hits
    z_out: wp.array3d[wp.uint16],  # likewise, in the colour camera
):
    """On the CPU; ``lines_words`` of scratch memory."""


@native_kernel(
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
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    model: int,
    fills: int,
    keys_out: wp.array3d[wp.uint32],  # (B, H, W), all bits set: lowered to depth << 16 | z
):
    """A block a tile of a depth image, on CUDA; the arguments are those of :func:`align_lines`."""
