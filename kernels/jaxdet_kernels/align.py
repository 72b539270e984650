"""Stage 1, align: depth at pixels of the colour image. Twin of ``jaxdet/reference/_align.py``.

A thread of the CPU or a team of threads on CUDA takes a frame; see ``include/jaxdet/alignment.h``.
"""

import warp as wp

from jaxdet_kernels.build import options

wp.set_module_options(options("alignment.h"))

WIDTH, BLOCKS = 256, 4
"""Threads of a team on CUDA, and how many teams are on a multiprocessor at once."""

TILE = 8
"""Rows and columns of a tile of depth pixels, as in ``alignment.h``."""

PARAMETERS = 26
"""Length of the projection's parameters, see ``projection.h``; then come the colour camera's lens,
whether a depth pixel covers all colour pixels between its corners, and height and width of the
colour image, as floats."""

Depth, Keys = wp.array3d[wp.uint16], wp.array2d[wp.uint32]
Rays, Bounds = wp.array3d[wp.float32], wp.array2d[wp.float32]
Floats, Pixels, Words = wp.array[wp.float32], wp.array2d[wp.int32], wp.array[wp.int32]
TYPES = Depth, Rays, Bounds, Floats, Pixels, Pixels, Keys, Pixels
"""Of the arrays of a call, those of :func:`align`."""


@wp.func_native("""
    using namespace jaxdet;
    const int frames = depth.shape[0], rows = depth.shape[1], columns = depth.shape[2];
    const int points = u.shape[1];
    const auto find = [&](size_t b, const Team& team, unsigned* near, int* own) {
        const size_t at = b * points;
        Alignment::of(parameters.data, depth.data + b * rows * columns, rows, columns,
                      rays.data, tile_rays.data, near, own)
            .run(team, points, u.data + at, v.data + at, keys_out.data + at);
    };
#if defined(__CUDA_ARCH__)
    __shared__ unsigned near[Alignment::NEAR_WORDS];
    const Team team(tid, 0);
    int* const own = scratch.data + (size_t)team.index * (scratch.shape[0] / gridDim.x);
    for (int b = team.index; b < frames; b += gridDim.x) {
        find(b, team, near, own);
        team.sync();
    }
#else
    unsigned near[Alignment::NEAR_WORDS];
    each_frame(next.data, frames, [&](size_t b) { find(b, Team(tid, 0), near, scratch.data); });
#endif
""")
def _align(
    tid: int,
    depth: Depth,
    rays: Rays,
    tile_rays: Bounds,
    parameters: Floats,
    u: Pixels,
    v: Pixels,
    keys_out: Keys,
    scratch: Words,
    next: Words,
): ...


@wp.kernel(launch_bounds=(WIDTH, BLOCKS))
def align(
    depth: Depth,  # (B, Hd, Wd) [depth units], 0 = no measurement
    rays: Rays,  # (2, Hd + 1, Wd + 1) x and y of the rays of the depth pixels' corners
    tile_rays: Bounds,  # (tiles, 4) least and largest x, then y, of the rays of each tile's corners
    parameters: Floats,  # (PARAMETERS + 4,)
    u: Pixels,  # (B, N) columns of pixels of the colour image
    v: Pixels,  # rows
    keys_out: Keys,  # (B, N) depth << 16 | z [depth units], 0 where nothing hits
    scratch: Words,  # of a thread on the CPU, of all teams on CUDA
    next: Words,  # (1,) first frame that no thread of the CPU has taken
):
    """Take frames until none is left; teams on CUDA take them in turn."""
    _align(wp.tid(), depth, rays, tile_rays, parameters, u, v, keys_out, scratch, next)


@wp.func_native("words.data[0] = jaxdet::Alignment::scratch_words(height, width);")
def _scratch_words(height: int, width: int, words: Words): ...


@wp.kernel
def scratch_words(height: int, width: int, words: Words):
    """Words of scratch memory of a thread or a team; launched by one thread."""
    _scratch_words(height, width, words)
