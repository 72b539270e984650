"""Corners where the depth allows them, with the depth looked up at few pixels only; for CUDA.

The mask decides two things: which 3x3 maxima may be corners, and the strongest allowed pixel,
whose strength sets the threshold. Both are known from ``corners_check`` and ``corners_strongest``
where the frame's list of candidates did not overflow. Where it did, a block does the frame by
itself: it looks for the strongest pixel, from the strongest down, and then looks up the maxima
above the threshold; a list in shared memory takes the pixels of a step and is emptied whenever it
may overflow.
"""

import warp as wp

from jaxdet_kernels.align_search import SEARCH

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

LOOKUP_BLOCK = 256
"""Threads of a block."""

_LOOKUP = (
    """
#if defined(__CUDA_ARCH__)
    const int b = block, lane = thread % 32;
    const int H = strength.shape[1], W = strength.shape[2], words = peak.shape[2];
    const int size = H * words, LIST = 10240, FULL = LIST - 256 * 32;
    const float* e = strength.data + (size_t)b * H * W;
    const int* peaks = peak.data + (size_t)b * size;
    unsigned* maxima = maxima_out.data + (size_t)b * size;
    const unsigned short* limit = limits.data + (size_t)which.data[b] * H * W;
    const unsigned least = bounds.data[0], most = bounds.data[1];
    __shared__ int count, best;
    __shared__ int list[LIST];
"""
    + SEARCH
    + """
    auto allowed = [&](int x, int y) -> bool {
        if (!masked) return true;
        const unsigned key = smallest_key(x, y), z = key & 0xffffu;
        return key != 0xffffffffu && z >= least && z <= most && z <= limit[y * W + x];
    };
    auto is_maximum = [&](int place) -> bool {
        const int y = place / W, x = place - y * W;
        bool maximum = y >= 1 && y < H - 1 && x >= 1 && x < W - 1;
        for (int k = 0; k < 9 && maximum; ++k)
            maximum = !(e[place + (k / 3 - 1) * W + k % 3 - 1] > e[place]);
        return maximum;
    };
    // What the list holds: the first step asks for the strongest allowed, the second for maxima.
    bool maxima_only = false;
    auto empty = [&]() {
        const int pixels = count;
        for (int k = thread; k < pixels; k += 256) {
            const int place = list[k], y = place / W, x = place - y * W;
            if (!allowed(x, y)) continue;
            // Strengths above 0 are ordered as the integers of their bits.
            if (maxima_only) atomicOr(&maxima[y * words + x / 32], 1u << x % 32);
            else atomicMax(&best, __float_as_int(e[place]));
        }
        __syncthreads();
        if (thread == 0) count = 0;
        __syncthreads();
    };
    for (int i = thread; i < size; i += 256) maxima[i] = 0;
    if (thread == 0) { count = 0; best = 0; }
    __syncthreads();
    const int slots = candidates.shape[1], listed = counts.data[b];
    if (listed <= slots) {
        const float strongest_allowed = __int_as_float(allowed_best.data[b]);
        const float threshold = (float)((double)strongest_allowed * (double)quality);
        for (int k = thread; k < listed; k += 256) {
            const int place = candidates.data[(size_t)b * slots + k];
            const int y = place / W, x = place - y * W;
            if (place >= 0 && e[place] > threshold && is_maximum(place))
                atomicOr(&maxima[y * words + x / 32], 1u << x % 32);
        }
        return;
    }
    const int top = strongest.data[b];
    const float strongest_of_all = __int_as_float(top);
    float high = strongest_of_all, low = high * 0.85f;
    bool done = top <= 0;
    while (!done) {
        for (int base = 0; base < size + 256; base += 256) {
            bool hot = false;
            if (base + thread < size) {
                const int bits = peaks[base + thread];
                hot = __int_as_float(bits < 0 ? bits ^ 0x7fffffff : bits) > low;
            }
            for (unsigned left = __ballot_sync(0xffffffffu, hot); left; left &= left - 1) {
                const int word = base + thread - lane + __ffs(left) - 1;
                const int y = word / words, x = (word - y * words) * 32 + lane, place = y * W + x;
                bool wanted = false;
                if (x < W) {
                    const float own = e[place];
                    wanted = own > low && own <= high;
                    if (maxima_only && wanted) wanted = is_maximum(place);
                }
                const unsigned votes = __ballot_sync(0xffffffffu, wanted);
                int at = 0;
                if (lane == 0 && votes) at = atomicAdd(&count, __popc(votes));
                at = __shfl_sync(0xffffffffu, at, 0);
                if (wanted) list[at + __popc(votes & ((1u << lane) - 1u))] = place;
            }
            __syncthreads();
            // The turn after the last word empties the list.
            if (__syncthreads_or(count > FULL || base >= size)) empty();
        }
        const int strongest_allowed = best;
        done = maxima_only || (strongest_allowed == 0 && low == 0.0f);
        high = low;
        low = low < strongest_of_all * 0.001f ? 0.0f : low * 0.75f;
        if (strongest_allowed > 0) {
            maxima_only = true;
            high = strongest_of_all;
            low = (float)((double)__int_as_float(strongest_allowed) * (double)quality);
        }
    }
#endif
"""
)


@wp.func_native(_LOOKUP)
def _lookup(
    block: int,
    thread: int,
    strength: wp.array3d[wp.float32],
    peak: wp.array3d[wp.int32],
    strongest: wp.array[wp.int32],
    candidates: wp.array2d[wp.int32],
    counts: wp.array[wp.int32],
    allowed_best: wp.array[wp.int32],
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
    quality: wp.float64,
    masked: int,
    maxima_out: wp.array3d[wp.uint32],
): ...


@wp.kernel(launch_bounds=(256, 4))
def corners_lookup(
    strength: wp.array3d[wp.float32],
    peak: wp.array3d[wp.int32],
    strongest: wp.array[wp.int32],
    candidates: wp.array2d[wp.int32],
    counts: wp.array[wp.int32],
    allowed_best: wp.array[wp.int32],
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
    quality: wp.float64,
    masked: int,
    maxima_out: wp.array3d[wp.uint32],
):
    """What ``corners_maxima`` finds with the mask of the dense alignment, a block a frame.

    ``strongest`` is the strongest pixel of each frame without a mask, as ``corners_eigenvalue``
    orders it, and ``counts`` are the lengths of its lists; ``candidates`` and ``allowed_best`` are
    from ``corners_check`` and ``corners_strongest``. Where ``masked`` is 0, every pixel is
    allowed, and they are the list itself and ``strongest``.
    """
    i = wp.tid()
    _lookup(
        i // 256, i % 256, strength, peak, strongest, candidates, counts, allowed_best, depth,
        tiles, ranges, corner_x, corner_y, parameters, search, limits, which, bounds, fills,
        quality, masked, maxima_out,
    )  # fmt: skip
