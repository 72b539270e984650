"""The last step of Canny: which weak edges hang together with strong ones; for CUDA.

Edge maps are laid out as in ``features_canny``.
"""

import warp as wp

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

HYSTERESIS_BLOCK = 1024
"""Threads of a block."""

_HYSTERESIS = """
#if defined(__CUDA_ARCH__)
    typedef unsigned long long u64;
    const unsigned all = 0xffffffffu;
    const int H = candidates.shape[1], n = candidates.shape[2] / 2;
    const u64* allowed = (const u64*)candidates.data + (size_t)block * H * n;
    const u64* seeds = (const u64*)strong.data + (size_t)block * H * n;
    volatile u64* reached = (volatile u64*)edges_out.data + (size_t)block * H * n;
    for (int i = thread; i < H * n; i += 1024) reached[i] = seeds[i];
    __syncthreads();
    const int lane = thread % 32, strip = (H + 31) / 32, parts = (n + 31) / 32;
    const int first = min((thread / 32) * strip, H), last = min(first + strip, H);
    int changed;
    do {
        changed = 0;
        // A part of a row is 32 words, one a lane; down and then up in each part.
        for (int turn = 0; turn < 2 * parts; ++turn) {
            const int sweep = turn % 2, word = turn / 2 * 32 + lane;
            const bool mine = word < n;
            const int from = sweep == 0 ? first - 1 : last;
            u64 previous = 0;
            if (mine && first < last && from >= 0 && from < H) previous = reached[from * n + word];
            // Of the word at either side of the part, the bit next to it, where it reaches to.
            const int beyond = lane == 0 ? word - 1 : lane == 31 ? word + 1 : -1;
            auto reached_beyond = [&](int y) -> u64 {
                if (beyond < 0 || beyond >= n || y < 0 || y >= H) return 0;
                return lane == 0 ? reached[y * n + beyond] >> 63 : reached[y * n + beyond] << 63;
            };
            for (int k = 0; k < last - first; ++k) {
                const int y = sweep == 0 ? first + k : last - 1 - k;
                u64 c = mine ? allowed[y * n + word] : 0;
                u64 old = mine ? reached[y * n + word] : 0;
                u64 left = __shfl_up_sync(all, previous, 1);
                u64 right = __shfl_down_sync(all, previous, 1);
                if (lane == 0) left = 0;
                if (lane == 31) right = 0;
                u64 near = previous | (previous << 1) | (previous >> 1);
                near |= (left >> 63) | (right << 63);
                if (parts > 1)
                    near |= reached_beyond(y) | reached_beyond(sweep == 0 ? y - 1 : y + 1);
                u64 now = old | (near & c);
                while (true) {
                    // Within a word, adding a seed to its run of ones carries to the run's end.
                    u64 up = (c & ~(c + now)) | now;
                    u64 rc = __brevll(c), rs = __brevll(up);
                    u64 full = __brevll((rc & ~(rc + rs)) | rs);
                    u64 l = __shfl_up_sync(all, full, 1), r = __shfl_down_sync(all, full, 1);
                    if (lane == 0) l = 0;
                    if (lane == 31) r = 0;
                    u64 next = full | (((l >> 63) | (r << 63)) & c);
                    now = next;
                    if (!__any_sync(all, next != full)) break;
                }
                if (now != old) {
                    reached[y * n + word] = now;
                    changed = 1;
                }
                previous = now;
            }
        }
    } while (__syncthreads_or(changed));
#endif
"""


@wp.func_native(_HYSTERESIS)
def _hysteresis(
    block: int,
    thread: int,
    candidates: wp.array3d[wp.uint32],
    strong: wp.array3d[wp.uint32],
    edges_out: wp.array3d[wp.uint32],
): ...


@wp.kernel(launch_bounds=1024)
def canny_hysteresis(
    candidates: wp.array3d[wp.uint32],
    strong: wp.array3d[wp.uint32],
    edges_out: wp.array3d[wp.uint32],
):
    """Candidates reachable from strong pixels, a block a frame, a warp a strip of rows."""
    i = wp.tid()
    _hysteresis(i // 1024, i % 1024, candidates, strong, edges_out)
