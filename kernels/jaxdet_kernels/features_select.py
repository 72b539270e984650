"""The strongest corners with a minimum distance, as OpenCV picks them one by one; for CUDA.

The greedy rule has a parallel form: a corner is taken once no stronger one near it is undecided,
and dropped as soon as a taken one is near. The result does not depend on the order of the steps.
"""

import warp as wp

from jaxdet_kernels.features_strongest import STRONGEST

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

SPREAD_BLOCK = 1024
"""Threads of a block."""

_SPREAD = """
#if defined(__CUDA_ARCH__)
    const int H = strength.shape[1], W = strength.shape[2], words = maxima.shape[2];
    const int size = H * words, N = strength_key_out.shape[1], LIST = 4096, NEAR = 16;
    unsigned* open = undecided_out.data + (size_t)block * size;
    unsigned* taken = taken_out.data + (size_t)block * size;
    const unsigned* start = maxima.data + (size_t)block * size;
    const float* e = strength.data + (size_t)block * H * W;
    const int reach = distance >= 1.0 ? (int)ceil(fmin(distance, 1e4)) - 1 : -1;
    // Whole squares below the distance's square are those below this whole number.
    const int limit = (int)ceil(fmin(distance * distance, 1e9));
    // Half the row, dy rows away, that is nearer than the distance; negative if none is.
    auto half_row = [&](int dy) -> int {
        int half = (int)sqrtf((float)max(limit - dy * dy, 0));
        while (half * half + dy * dy >= limit) --half;
        while ((half + 1) * (half + 1) + dy * dy < limit) ++half;
        return half;
    };
    // The columns from .. to in word w.
    auto part = [&](int w, int from, int to) -> unsigned {
        unsigned in = 0xffffffffu;
        if (w == from >> 5) in &= 0xffffffffu << (from & 31);
        if (w == to >> 5) in &= 0xffffffffu >> (31 - (to & 31));
        return in;
    };
    __shared__ int count, list[LIST], bits[LIST];
    __shared__ volatile unsigned char state[LIST];
    if (thread == 0) count = 0;
    __syncthreads();
    // Few candidates go into a list; open tells where in it those of a word begin.
    for (int i = thread; i < size && reach >= 0; i += 1024) {
        unsigned left = start[i];
        if (left == 0) continue;
        int at = atomicAdd(&count, __popc(left));
        open[i] = at;
        const int y = i / words, x = (i - y * words) * 32;
        for (; left && at < LIST; left &= left - 1, ++at) {
            list[at] = y * W + x + __ffs(left) - 1;
            bits[at] = __float_as_int(e[list[at]]);
            state[at] = 0;
        }
    }
    __syncthreads();
    const int corners = count;
    bool few = reach >= 0 && corners <= LIST;
    unsigned short near[LIST / 1024][NEAR];
    int nears[LIST / 1024];
    if (few) {
        // The stronger ones near each candidate; of equals the last in raster order is stronger.
        bool too_many = false;
        #pragma unroll
        for (int k = 0; k < LIST / 1024; ++k) {
            nears[k] = 0;
            const int own = k * 1024 + thread;
            if (own >= corners) continue;
            const int place = list[own], y = place / W, x = place - y * W;
            const float strength = __int_as_float(bits[own]);
            for (int v = max(y - reach, 0); v <= min(y + reach, H - 1); ++v) {
                const int half = half_row(v - y);
                const int from = max(x - half, 0), to = min(x + half, W - 1);
                for (int w = from >> 5; w <= to >> 5 && half >= 0; ++w) {
                    const unsigned word = start[v * words + w];
                    for (unsigned left = word & part(w, from, to); left; left &= left - 1) {
                        const unsigned before = (left & -left) - 1;
                        const int other = (int)open[v * words + w] + __popc(word & before);
                        const float its = __int_as_float(bits[other]);
                        if (!(its > strength || (its == strength && other != own
                                                 && list[other] > place))) continue;
                        if (nears[k] == NEAR) { too_many = true; continue; }
                        near[k][nears[k]++] = (unsigned short)other;
                    }
                }
            }
        }
        few = !__syncthreads_or(too_many);
    }
    if (few) {
        // State 0 waits, 1 is taken, 2 dropped. A state once set stays, so threads need not wait
        // for each other: all that is read is final or leads to another turn.
        int undecided = 0, took = 0;
        for (int k = 0; k < LIST / 1024; ++k)
            if (k * 1024 + thread < corners) undecided |= 1 << k;
        while (__syncthreads_or(undecided)) {
            #pragma unroll
            for (int k = 0; k < LIST / 1024; ++k) {
                if (!(undecided >> k & 1)) continue;
                int verdict = 1;
                for (int i = 0; i < nears[k] && verdict != 2; ++i) {
                    const int its = state[near[k][i]];
                    if (its == 1) verdict = 2;
                    if (its == 0) verdict = 0;
                }
                if (verdict == 0) continue;
                state[k * 1024 + thread] = (unsigned char)verdict;
                took |= (verdict & 1) << k;
                undecided &= ~(1 << k);
            }
        }
        // The list is then of the taken ones.
        int places[LIST / 1024], strengths[LIST / 1024];
        for (int k = 0; k < LIST / 1024; ++k) {
            places[k] = list[k * 1024 + thread];
            strengths[k] = bits[k * 1024 + thread];
        }
        if (thread == 0) count = 0;
        __syncthreads();
        for (int k = 0; k < LIST / 1024; ++k) {
            if (!(took >> k & 1)) continue;
            const int at = atomicAdd(&count, 1);
            list[at] = places[k];
            bits[at] = strengths[k];
        }
    } else {
        for (int i = thread; i < size; i += 1024) {
            open[i] = reach >= 0 ? start[i] : 0u;
            taken[i] = reach >= 0 ? 0u : start[i];
        }
        __syncthreads();
        // Taken once no stronger one near it is undecided, and dropped next to a taken one.
        auto decide = [&](int i, int bit) -> int {  // 1 takes the corner, -1 drops it, 0 waits
            const int y = i / words, x = (i - y * words) * 32 + bit;
            const float own = e[(size_t)y * W + x];
            bool waits = false;
            for (int v = max(y - reach, 0); v <= min(y + reach, H - 1); ++v) {
                const int half = half_row(v - y);
                const int from = max(x - half, 0), to = min(x + half, W - 1);
                for (int w = from >> 5; w <= to >> 5 && half >= 0; ++w) {
                    const unsigned in = part(w, from, to);
                    if (taken[v * words + w] & in) return -1;
                    if (waits) continue;
                    for (unsigned left = open[v * words + w] & in; left; left &= left - 1) {
                        const int u = w * 32 + __ffs(left) - 1;
                        const float other = e[(size_t)v * W + u];
                        if (other > own || (other == own && v * W + u > y * W + x)) {
                            waits = true;
                            break;
                        }
                    }
                }
            }
            return waits ? 0 : 1;
        };
        // Many: a thread keeps words of the map.
        int more = 1;
        while (__syncthreads_or(more)) {
            more = 0;
            for (int base = 0; base < size; base += 1024 * 16) {
                unsigned accept[16], reject[16];
                for (int k = 0; k < 16; ++k) {
                    const int i = base + k * 1024 + thread;
                    accept[k] = 0u; reject[k] = 0u;
                    if (i >= size) continue;
                    for (unsigned left = open[i]; left; left &= left - 1) {
                        const int bit = __ffs(left) - 1, verdict = decide(i, bit);
                        if (verdict > 0) accept[k] |= 1u << bit;
                        if (verdict < 0) reject[k] |= 1u << bit;
                    }
                }
                __syncthreads();
                for (int k = 0; k < 16; ++k) {
                    const int i = base + k * 1024 + thread;
                    if (i >= size) continue;
                    taken[i] |= accept[k];
                    open[i] &= ~(accept[k] | reject[k]);
                    if (open[i]) more = 1;
                }
                __syncthreads();
            }
        }
    }
    __syncthreads();
    if (!few) {
        if (thread == 0) count = 0;
        __syncthreads();
        int own = 0;
        for (int i = thread; i < size; i += 1024) own += __popc(taken[i]);
        atomicAdd(&count, own);
        __syncthreads();
    }
    const int found = count;
    __syncthreads();
"""


@wp.func_native(_SPREAD + STRONGEST)
def _spread(
    block: int,
    thread: int,
    strength: wp.array3d[wp.float32],
    maxima: wp.array3d[wp.uint32],
    distance: wp.float64,
    strength_key_out: wp.array2d[wp.uint32],
    place_key_out: wp.array2d[wp.uint32],
    found_out: wp.array[wp.int32],
    undecided_out: wp.array3d[wp.uint32],
    taken_out: wp.array3d[wp.uint32],
): ...


@wp.kernel(launch_bounds=1024)
def corners_spread(
    strength: wp.array3d[wp.float32],
    maxima: wp.array3d[wp.uint32],
    distance: wp.float64,
    strength_key_out: wp.array2d[wp.uint32],
    place_key_out: wp.array2d[wp.uint32],
    found_out: wp.array[wp.int32],
    undecided_out: wp.array3d[wp.uint32],
    taken_out: wp.array3d[wp.uint32],
):
    """The greedy minimum distance and the strongest N, a block a frame; unsorted."""
    i = wp.tid()
    _spread(
        i // 1024, i % 1024, strength, maxima, distance,
        strength_key_out, place_key_out, found_out, undecided_out, taken_out,
    )  # fmt: skip
