"""Local maxima of the strength, where a mask allows them; for CUDA."""

import warp as wp

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

MAXIMA_BLOCK = 256
"""Threads of a block."""

_MAXIMA = """
#if defined(__CUDA_ARCH__)
    const int H = strength.shape[1], W = strength.shape[2], words = maxima_out.shape[2];
    const unsigned frame = H * words, all = strength.shape[0] * frame, lane = thread % 32;
    const unsigned first = ((unsigned)block * 256u + thread) / 32u * 32u, mine = first + lane;
    unsigned result = 0, hot = 0;
    float threshold = 0.0f;
    if (mine < all) {
        const int ordered = best.data[mine / frame];
        if (ordered != (int)0x80000000) {
            const float strongest = __int_as_float(ordered < 0 ? ordered ^ 0x7fffffff : ordered);
            threshold = (float)((double)strongest * (double)quality);
            const int bits = peak.data[mine];
            hot = __int_as_float(bits < 0 ? bits ^ 0x7fffffff : bits) > threshold;
        }
    }
    // Each lane looks after a word; those that aren't flat are then searched by the whole warp.
    for (unsigned left = __ballot_sync(0xffffffffu, hot); left; left &= left - 1) {
        const int turn = __ffs(left) - 1;
        const float limit = __shfl_sync(0xffffffffu, threshold, turn);
        const unsigned job = first + turn, b = job / frame, rest = job - b * frame;
        const unsigned row = rest / words;
        const int y = row, x = (rest - row * words) * 32 + lane;
        bool corner = false;
        if (y >= 1 && y < H - 1 && x >= 1 && x < W - 1) {
            const float* e = strength.data + ((size_t)b * H + y) * W + x;
            const float v = e[0];
            corner = v > limit && v != 0.0f
                && mask.data[((size_t)b * H + y) * W + x];
            if (corner) {
                for (int dy = -1; dy <= 1; ++dy)
                    for (int dx = -1; dx <= 1; ++dx) {
                        const float near = e[dy * W + dx];
                        corner = corner && !((near > limit ? near : 0.0f) > v);
                    }
            }
        }
        const unsigned word = __ballot_sync(0xffffffffu, corner);
        if (lane == turn) result = word;
    }
    if (mine < all) maxima_out.data[mine] = result;
#endif
"""


@wp.func_native(_MAXIMA)
def _maxima(
    block: int,
    thread: int,
    strength: wp.array3d[wp.float32],
    mask: wp.array3d[wp.bool],
    best: wp.array[wp.int32],
    peak: wp.array3d[wp.int32],
    quality: wp.float64,
    maxima_out: wp.array3d[wp.uint32],
): ...


@wp.kernel
def corners_maxima(
    strength: wp.array3d[wp.float32],
    mask: wp.array3d[wp.bool],
    best: wp.array[wp.int32],
    peak: wp.array3d[wp.int32],
    quality: wp.float64,
    maxima_out: wp.array3d[wp.uint32],
):
    """Allowed 3x3 maxima above the quality threshold, a thread a word."""
    i = wp.tid()
    _maxima(i // 256, i % 256, strength, mask, best, peak, quality, maxima_out)
