"""Kernels of the preset ``paper``: corners of colour images, and depth at their pixels.

Twins of ``_canny.py``, ``_corners.py`` and ``_align.py`` in ``jaxdet/reference/paper``. The last
parameters of a kernel on frames are scratch memory, of one thread on the CPU and of all teams on
CUDA, and ``next (1,)``, the index of the first frame that no CPU thread has taken.
"""

import warp as wp

from jaxdet_kernels.build import BLOCKS, WIDTH, options

wp.set_module_options(options("corners.h", "alignment.h"))

MAX_SIZE = 4096  # a row and a column are packed into 32 bits
"""Maximum number of columns and rows of a colour image: pixel indices have 24 bits."""

TILE = 8
"""Rows and columns of a tile of depth pixels, as in ``alignment.h``."""

PARAMETERS = 26
"""Number of parameters of the projection, see ``projection.h``. They are followed by the colour
camera's lens model, whether a depth pixel covers all colour pixels between its corners, and height
and width of the colour image, as floats."""

Color, Depth, Rays = wp.array4d[wp.uint8], wp.array3d[wp.uint16], wp.array3d[wp.float32]
Rows, Keys, Bounds = wp.array2d[wp.int32], wp.array2d[wp.uint32], wp.array2d[wp.float32]
Words, Floats = wp.array[wp.int32], wp.array[wp.float32]


@wp.func_native("""
    using namespace jaxdet;
    const int height = color.shape[1], width = color.shape[2], slots = u.shape[1];
    const Corners corners{height, width, *(const CornerSettings*)settings.data, slots};
    by_frames<Corners::Shared>(
        tid, color.shape[0], next.data, scratch.data, scratch.shape[0],
        [&](size_t b, const Team& team, Corners::Shared& shared, int* own) {
            corners.run(team, shared, color.data + 3 * b * height * width, own,
                        u.data + b * slots, v.data + b * slots, number.data + b);
        });
""")
def _corners(
    tid: int, color: Color, settings: Words, u: Rows, v: Rows, number: Words, scratch: Words,
    next: Words,
): ...  # fmt: skip


@wp.kernel(launch_bounds=(WIDTH, BLOCKS))
def corners(
    color: Color,  # (B, H, W, 3) RGB
    settings: Words,  # CornerSettings of corners.h
    u: Rows,  # (B, N) result: columns, strongest corner first; 0 in empty slots
    v: Rows,  # (B, N) result: rows
    number: Words,  # (B,) result: number of corners, N + 1 if there are more than N
    scratch: Words,
    next: Words,
):
    """Find the strongest corners of the Canny edges of each image."""
    _corners(wp.tid(), color, settings, u, v, number, scratch, next)


@wp.func_native("words.data[0] = jaxdet::Corners::scratch_words(height, width);")
def _corners_words(height: int, width: int, words: Words): ...


@wp.kernel
def corners_words(height: int, width: int, words: Words):
    """Write the number of scratch words per thread or team; launched with one thread."""
    _corners_words(height, width, words)


@wp.func_native("""
    using namespace jaxdet;
    const int rows = depth.shape[1], columns = depth.shape[2], points = u.shape[1];
    by_frames<Alignment::Near>(
        tid, depth.shape[0], next.data, scratch.data, scratch.shape[0],
        [&](size_t b, const Team& team, Alignment::Near& near, int* own) {
            Alignment::of(parameters.data, depth.data + b * rows * columns, rows, columns,
                          rays.data, tile_rays.data, near.words, own)
                .run(team, points, u.data + b * points, v.data + b * points,
                     keys.data + b * points);
        });
""")
def _align(
    tid: int, depth: Depth, rays: Rays, tile_rays: Bounds, parameters: Floats, u: Rows, v: Rows,
    keys: Keys, scratch: Words, next: Words,
): ...  # fmt: skip


@wp.kernel(launch_bounds=(WIDTH, BLOCKS))
def align(
    depth: Depth,  # (B, Hd, Wd) [depth units], 0 = no measurement
    rays: Rays,  # (2, Hd + 1, Wd + 1) x and y of the rays of the depth pixels' corners
    # (tiles, 4) smallest and largest x, then y, of the rays of each tile's corners
    tile_rays: Bounds,
    parameters: Floats,  # (PARAMETERS + 4,)
    u: Rows,  # (B, N) columns of pixels of the colour image
    v: Rows,  # (B, N) rows
    keys: Keys,  # (B, N) result: depth << 16 | z [depth units], 0 if the pixel is not covered
    scratch: Words,
    next: Words,
):
    """Find the depth at pixels of the colour image."""
    _align(wp.tid(), depth, rays, tile_rays, parameters, u, v, keys, scratch, next)


@wp.func_native("words.data[0] = jaxdet::Alignment::scratch_words(height, width);")
def _align_words(height: int, width: int, words: Words): ...


@wp.kernel
def align_words(height: int, width: int, words: Words):
    """Write the number of scratch words per thread or team; launched with one thread."""
    _align_words(height, width, words)
