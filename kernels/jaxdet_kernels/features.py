"""Canny edges and Shi-Tomasi corners. Twin of the reference's ``_canny.py`` and ``_corners.py``.

On the CPU a thread processes a frame from colours to corners, on CUDA a team of threads; see
``include/jaxdet/corners.h``.
"""

import warp as wp

from jaxdet_kernels.build import options

wp.set_module_options(options("corners.h"))

WIDTH, BLOCKS = 256, 4
"""Threads per team on CUDA, and teams that are resident on a multiprocessor at once."""

Color, Rows, Words = wp.array4d[wp.uint8], wp.array2d[wp.int32], wp.array[wp.int32]
TYPES = Color, Words, Rows, Rows, Words, Rows
"""Types of the arrays of a call of :func:`corners`."""

MAX_SIZE = 4096  # a row and a column fit in 32 bits
"""Maximum number of columns and rows of a colour image: pixel indices have 24 bits."""


@wp.func_native("""
    using namespace jaxdet;
    const int frames = color.shape[0], height = color.shape[1], width = color.shape[2];
    const int slots = u_out.shape[1];
    const Corners corners{height, width, {settings.data}, slots};
    by_frames<Corners::Shared>(
        tid, frames, next.data, scratch.data, scratch.shape[0],
        [&](size_t b, const Team& team, Corners::Shared& shared, int* own) {
            corners.run(team, shared, color.data + 3 * b * height * width, own,
                        u_out.data + b * slots, v_out.data + b * slots, found_out.data + b);
        });
""")
def _corners(
    tid: int,
    color: Color,
    settings: Words,
    u_out: Rows,
    v_out: Rows,
    found_out: Words,
    scratch: Words,
    next: Words,
): ...


@wp.kernel(launch_bounds=(WIDTH, BLOCKS))
def corners(
    color: Color,  # (B, H, W, 3) RGB
    settings: Words,  # (5,) see corners.h
    u_out: Rows,  # (B, N) columns, strongest corner first; 0 in empty slots
    v_out: Rows,  # rows
    found_out: Words,  # (B,) number of corners, at most N + 1
    scratch: Words,  # scratch memory of one thread on the CPU, of all teams on CUDA
    next: Words,  # (1,) index of the first frame that no CPU thread has taken
):
    """Process frames until none is left; on CUDA, frames are assigned to teams in turn."""
    _corners(wp.tid(), color, settings, u_out, v_out, found_out, scratch, next)


@wp.func_native("words.data[0] = jaxdet::Corners::scratch_words(height, width);")
def _scratch_words(height: int, width: int, words: Words): ...


@wp.kernel
def scratch_words(height: int, width: int, words: Words):
    """Write the number of scratch words per thread or team; launched with one thread."""
    _scratch_words(height, width, words)
