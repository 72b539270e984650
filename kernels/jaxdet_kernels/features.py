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
"""Types of the arrays of a call: those of a batch, and scratch memory."""

MAX_SIZE = 4096  # a row and a column fit in 32 bits
"""Maximum number of columns and rows of a colour image: pixel indices have 24 bits."""


@wp.struct
class Batch:
    """Arrays of a batch of frames."""

    color: Color  # (B, H, W, 3) RGB
    settings: Words  # (5,) see corners.h
    u: Rows  # (B, N) result: columns, strongest corner first; 0 in empty slots
    v: Rows  # rows
    number: Words  # (B,) result: number of corners, at most N + 1


@wp.func_native("""
    using namespace jaxdet;
    const auto& of = batch;
    const int height = of.color.shape[1], width = of.color.shape[2], slots = of.u.shape[1];
    const Corners corners{height, width, {of.settings.data}, slots};
    by_frames<Corners::Shared>(
        tid, of.color.shape[0], next.data, scratch.data, scratch.shape[0],
        [&](size_t b, const Team& team, Corners::Shared& shared, int* own) {
            corners.run(team, shared, of.color.data + 3 * b * height * width, own,
                        of.u.data + b * slots, of.v.data + b * slots, of.number.data + b);
        });
""")
def _corners(tid: int, batch: Batch, scratch: Words, next: Words): ...


@wp.kernel(launch_bounds=(WIDTH, BLOCKS))
def corners(
    batch: Batch,
    scratch: Words,  # scratch memory of one thread on the CPU, of all teams on CUDA
    next: Words,  # (1,) index of the first frame that no CPU thread has taken
):
    """Process frames until none is left; on CUDA, frames are assigned to teams in turn."""
    _corners(wp.tid(), batch, scratch, next)


@wp.func_native("words.data[0] = jaxdet::Corners::scratch_words(height, width);")
def _scratch_words(height: int, width: int, words: Words): ...


@wp.kernel
def scratch_words(height: int, width: int, words: Words):
    """Write the number of scratch words per thread or team; launched with one thread."""
    _scratch_words(height, width, words)
