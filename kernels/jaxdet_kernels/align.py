"""Stage 1, align: depth at pixels of the colour image. Twin of ``jaxdet/reference/_align.py``.

On the CPU a thread processes a frame, on CUDA a team of threads; see
``include/jaxdet/alignment.h``.
"""

import warp as wp

from jaxdet_kernels.build import options

wp.set_module_options(options("alignment.h"))

WIDTH, BLOCKS = 256, 4
"""Threads per team on CUDA, and teams that are resident on a multiprocessor at once."""

TILE = 8
"""Rows and columns of a tile of depth pixels, as in ``alignment.h``."""

PARAMETERS = 26
"""Number of parameters of the projection, see ``projection.h``. They are followed by the colour
camera's lens model, whether a depth pixel covers all colour pixels between its corners, and height
and width of the colour image, as floats."""

Depth, Keys = wp.array3d[wp.uint16], wp.array2d[wp.uint32]
Rays, Bounds = wp.array3d[wp.float32], wp.array2d[wp.float32]
Floats, Pixels, Words = wp.array[wp.float32], wp.array2d[wp.int32], wp.array[wp.int32]
TYPES = Depth, Rays, Bounds, Floats, Pixels, Pixels, Keys, Pixels
"""Types of the arrays of a call: those of a batch, and scratch memory."""


@wp.struct
class Batch:
    """Arrays of a batch of frames."""

    depth: Depth  # (B, Hd, Wd) [depth units], 0 = no measurement
    rays: Rays  # (2, Hd + 1, Wd + 1) x and y of the rays of the depth pixels' corners
    # (tiles, 4) smallest and largest x, then y, of the rays of each tile's corners
    tile_rays: Bounds
    parameters: Floats  # (PARAMETERS + 4,)
    u: Pixels  # (B, N) columns of pixels of the colour image
    v: Pixels  # rows
    keys: Keys  # (B, N) result: depth << 16 | z [depth units], 0 if no depth pixel covers the pixel


@wp.func_native("""
    using namespace jaxdet;
    const auto& of = batch;
    const int rows = of.depth.shape[1], columns = of.depth.shape[2], points = of.u.shape[1];
    by_frames<Alignment::Near>(
        tid, of.depth.shape[0], next.data, scratch.data, scratch.shape[0],
        [&](size_t b, const Team& team, Alignment::Near& near, int* own) {
            Alignment::of(of.parameters.data, of.depth.data + b * rows * columns, rows, columns,
                          of.rays.data, of.tile_rays.data, near.words, own)
                .run(team, points, of.u.data + b * points, of.v.data + b * points,
                     of.keys.data + b * points);
        });
""")
def _align(tid: int, batch: Batch, scratch: Words, next: Words): ...


@wp.kernel(launch_bounds=(WIDTH, BLOCKS))
def align(
    batch: Batch,
    scratch: Words,  # scratch memory of one thread on the CPU, of all teams on CUDA
    next: Words,  # (1,) index of the first frame that no CPU thread has taken
):
    """Process frames until none is left; on CUDA, frames are assigned to teams in turn."""
    _align(wp.tid(), batch, scratch, next)


@wp.func_native("words.data[0] = jaxdet::Alignment::scratch_words(height, width);")
def _scratch_words(height: int, width: int, words: Words): ...


@wp.kernel
def scratch_words(height: int, width: int, words: Words):
    """Write the number of scratch words per thread or team; launched with one thread."""
    _scratch_words(height, width, words)
