"""Stage align: depth pixels moved into the colour image. Twin of ``jaxdet/reference/_align.py``."""

import warp as wp

from jaxdet_kernels.build import options

wp.set_module_options(options("alignment.h"))

PARAMETERS = 26
"""Length of the parameters, see ``projection.h``; then come the colour camera's lens and whether a
depth pixel covers all colour pixels between its corners, as floats."""

TILE_BLOCK, TILE_ROWS, TILE_COLUMNS = 256, 16, 32
"""Threads of a block on CUDA, and its tile of the depth image; see ``alignment.h``."""

SPARE = 20  # keys behind each image and line on the CPU, likewise

NOTHING = 0xFFFFFFFF  # a key that no pixel has lowered

Depth = wp.array3d[wp.uint16]
Rays = wp.array2d[wp.float32]
Floats = wp.array[wp.float32]
Keys = wp.array3d[wp.uint32]
TYPES = Depth, Rays, Rays, Floats, Depth, Depth, Keys
"""Of the arrays of a call: those of :func:`align_lines`, then those of :func:`align_tiles`."""


def lines_words(height: int, width: int) -> int:
    """Words of scratch memory of a thread on the CPU: an image of keys and 4 lines."""
    return height * width + SPARE + 4 * (width + SPARE)


@wp.func_native("""
#if !defined(__CUDA_ARCH__)
    const int rows = depth.shape[1], columns = depth.shape[2];
    const int height = depth_out.shape[1], width = depth_out.shape[2];
    const size_t size = (size_t)height * width;
    unsigned* const keys = (unsigned*)scratch.data;
    jaxdet::each_frame(next.data, depth.shape[0], [&](size_t b) {
        jaxdet::Alignment::of(parameters.data, depth.data + b * rows * columns, rows, columns,
                              corner_x.data, corner_y.data, height, width, keys)
            .run(keys + size + jaxdet::Alignment::SPARE, depth_out.data + b * size,
                 z_out.data + b * size);
    });
#endif
""")
def _align_lines(
    depth: Depth,
    corner_x: Rays,
    corner_y: Rays,
    parameters: Floats,
    depth_out: Depth,
    z_out: Depth,
    scratch: wp.array[wp.int32],
    next: wp.array[wp.int32],
): ...


@wp.kernel
def align_lines(
    depth: Depth,  # (B, Hd, Wd) [depth units], 0 = no measurement
    corner_x: Rays,  # (Hd + 1, Wd + 1) rays of the depth pixels' corners
    corner_y: Rays,
    parameters: Floats,  # (PARAMETERS + 2,)
    depth_out: Depth,  # (B, H, W) [depth units], 0 where nothing hits
    z_out: Depth,  # the same, in the colour camera
    scratch: wp.array[wp.int32],  # (lines_words,)
    next: wp.array[wp.int32],
):
    """Takes frames until none is left, on the CPU."""
    _align_lines(depth, corner_x, corner_y, parameters, depth_out, z_out, scratch, next)


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    using namespace jaxdet;
    const Team team(0, blockIdx.x);  // of large batches tid has more than 31 bits
    const int rows = depth.shape[1], columns = depth.shape[2];
    const int height = keys_out.shape[1], width = keys_out.shape[2];
    const ImageTile at(team, Alignment::TILE_ROWS, Alignment::TILE_COLUMNS, rows, columns);
    Alignment::of(parameters.data, depth.data + (size_t)at.image * rows * columns, rows, columns,
                  corner_x.data, corner_y.data, height, width,
                  keys_out.data + (size_t)at.image * height * width)
        .lower_by_tile(team, at);
#endif
""")
def _align_tiles(
    depth: Depth,
    corner_x: Rays,
    corner_y: Rays,
    parameters: Floats,
    keys_out: Keys,
): ...


@wp.kernel(launch_bounds=(TILE_BLOCK, 4))
def align_tiles(
    depth: Depth,
    corner_x: Rays,
    corner_y: Rays,
    parameters: Floats,
    keys_out: Keys,  # (B, H, W), all bits set: lowered to depth << 16 | z
):
    """A block a tile of a depth image, on CUDA; the arguments are those of :func:`align_lines`."""
    _align_tiles(depth, corner_x, corner_y, parameters, keys_out)
