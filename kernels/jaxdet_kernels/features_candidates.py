"""Which candidates for corners the depth allows, all frames at once; for CUDA.

Two steps: look up the depth of each candidate; look at the few pixels that are stronger than the
strongest allowed candidate, as one of them may set the threshold. Strengths above 0 are ordered as
the integers of their bits.
"""

import warp as wp

from jaxdet_kernels.align_search import SEARCH

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

CANDIDATES_BLOCK = 256
"""Threads of a block."""

_ALLOWED = """
    auto allowed = [&](int x, int y) -> bool {
        const unsigned key = smallest_key(x, y), z = key & 0xffffu;
        const size_t at = ((size_t)which.data[b] * H + y) * W + x;
        return key != 0xffffffffu && z >= bounds.data[0] && z <= bounds.data[1]
            && z <= limits.data[at];
    };
"""

_CHECK = (
    """
#if defined(__CUDA_ARCH__)
    const int H = strength.shape[1], W = strength.shape[2], size = list.shape[1];
    const int b = block / (size / 256), k = block % (size / 256) * 256 + thread;
    if (k >= count.data[b]) return;
"""
    + SEARCH
    + _ALLOWED
    + """
    const int place = list.data[(size_t)b * size + k], y = place / W;
    const bool may = allowed(place - y * W, y);
    allowed_out.data[(size_t)b * size + k] = may ? place : -1;
    const int bits = __float_as_int(strength.data[(size_t)b * H * W + place]);
    if (may && bits > best_out.data[b]) atomicMax(&best_out.data[b], bits);
#endif
"""
)

_STRONGEST = (
    """
#if defined(__CUDA_ARCH__)
    const int H = strength.shape[1], W = strength.shape[2], words = peak.shape[2];
    const int lane = thread % 32;
    const unsigned frame = H * words, all = strength.shape[0] * frame;
    // Each lane looks after four words; those with a stronger pixel are searched by the warp.
    const unsigned first = ((unsigned)block * 256u + thread - lane) * 4u;
    int peaks[4];
    #pragma unroll
    for (int k = 0; k < 4; ++k) {
        const unsigned word = first + 32u * k + lane;
        peaks[k] = word < all ? peak.data[word] : 0;
    }
    unsigned hot[4];
    #pragma unroll
    for (int k = 0; k < 4; ++k) {
        const unsigned word = min(first + 32u * k + lane, all - 1u);
        const int best = best_out.data[word / frame];
        hot[k] = __ballot_sync(0xffffffffu, best > 0 && peaks[k] > best);
    }
    #pragma unroll 1
    for (int k = 0; k < 4; ++k)
    #pragma unroll 1
    for (unsigned left = k == 0 ? hot[0] : k == 1 ? hot[1] : k == 2 ? hot[2] : hot[3]; left;
         left &= left - 1) {
        const unsigned job = first + 32u * k + __ffs(left) - 1, rest = job % frame;
        const int b = job / frame;
        const int y = rest / words, x = (rest - (unsigned)y * words) * 32 + lane;
        if (x >= W) continue;
        const int bits = __float_as_int(strength.data[((size_t)b * H + y) * W + x]);
        if (bits <= best_out.data[b]) continue;
"""
    + SEARCH
    + _ALLOWED
    + """
        if (allowed(x, y)) atomicMax(&best_out.data[b], bits);
    }
#endif
"""
)


@wp.func_native(_CHECK)
def _check(
    block: int,
    thread: int,
    strength: wp.array3d[wp.float32],
    list: wp.array2d[wp.int32],
    count: wp.array[wp.int32],
    depth: wp.array3d[wp.uint16],
    tiles: wp.array3d[wp.uint32],
    ranges: wp.array[wp.uint32],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    search: wp.array[wp.float32],
    limits: wp.array3d[wp.uint16],
    which: wp.array[wp.int32],
    bounds: wp.array[wp.uint16],
    fills: int,
    best_out: wp.array[wp.int32],
    allowed_out: wp.array2d[wp.int32],
): ...


@wp.kernel(launch_bounds=(256, 4))
def corners_check(
    strength: wp.array3d[wp.float32],
    list: wp.array2d[wp.int32],
    count: wp.array[wp.int32],
    depth: wp.array3d[wp.uint16],
    tiles: wp.array3d[wp.uint32],
    ranges: wp.array[wp.uint32],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    search: wp.array[wp.float32],
    limits: wp.array3d[wp.uint16],
    which: wp.array[wp.int32],
    bounds: wp.array[wp.uint16],
    fills: int,
    best_out: wp.array[wp.int32],
    allowed_out: wp.array2d[wp.int32],
):
    """The entries of the list that the depth allows, -1 for the others; the strongest of them.

    A thread an entry; lists are as long as a multiple of 256.
    """
    i = wp.tid()
    _check(
        i // 256, i % 256, strength, list, count, depth, tiles, ranges, corner_x, corner_y,
        parameters, search, limits, which, bounds, fills, best_out, allowed_out,
    )  # fmt: skip


@wp.func_native(_STRONGEST)
def _strongest(
    block: int,
    thread: int,
    strength: wp.array3d[wp.float32],
    peak: wp.array3d[wp.int32],
    depth: wp.array3d[wp.uint16],
    tiles: wp.array3d[wp.uint32],
    ranges: wp.array[wp.uint32],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    search: wp.array[wp.float32],
    limits: wp.array3d[wp.uint16],
    which: wp.array[wp.int32],
    bounds: wp.array[wp.uint16],
    fills: int,
    best_out: wp.array[wp.int32],
): ...


@wp.kernel(launch_bounds=(256, 4))
def corners_strongest(
    strength: wp.array3d[wp.float32],
    peak: wp.array3d[wp.int32],
    depth: wp.array3d[wp.uint16],
    tiles: wp.array3d[wp.uint32],
    ranges: wp.array[wp.uint32],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    search: wp.array[wp.float32],
    limits: wp.array3d[wp.uint16],
    which: wp.array[wp.int32],
    bounds: wp.array[wp.uint16],
    fills: int,
    best_out: wp.array[wp.int32],
):
    """Raises ``best_out``, where above 0, to the strongest allowed pixel of all.

    A thread four words of 32 columns.
    """
    i = wp.tid()
    _strongest(
        i // 256, i % 256, strength, peak, depth, tiles, ranges, corner_x, corner_y, parameters,
        search, limits, which, bounds, fills, best_out,
    )  # fmt: skip
