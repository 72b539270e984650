"""Canny edges of a batch of frames, to the bit of ``jaxdet/reference/_canny.py``; for CUDA.

Edge maps are rows of 32-bit words, bit ``i`` of word ``w`` being column ``32 w + i``; rows have an
even number of words, so that they can be read as 64-bit words.
"""

import warp as wp

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

SUPPRESS_BLOCK, SUPPRESS_ROWS, SUPPRESS_COLUMNS = 256, 16, 64
HYSTERESIS_BLOCK = 1024
"""Threads of a block, and the tile of an image that a block of ``canny_suppress`` handles."""

_SUPPRESS = """
#if defined(__CUDA_ARCH__)
    const int H = color.shape[1], W = color.shape[2], words = candidates_out.shape[2];
    const int tiles_x = words / 2, tiles_y = (H + 15) / 16;
    const int b = block / (tiles_x * tiles_y), tile = block % (tiles_x * tiles_y);
    const int y0 = (tile / tiles_x) * 16, x0 = (tile % tiles_x) * 64;
    const unsigned char* rgb = color.data + (size_t)b * H * W * 3;
    // Grey with a border of 2 rows and 4 columns; inside the image four pixels are three words.
    __shared__ short grey[20][72];
    __shared__ short magnitude[18][66];
    const bool whole = W % 4 == 0 && x0 >= 4 && x0 + 68 <= W;
    for (int i = thread; i < 20 * 18; i += 256) {
        const int r = i / 18, c = (i - r * 18) * 4;
        const int y = min(max(y0 + r - 2, 0), H - 1);
        const unsigned char* row = rgb + (size_t)y * W * 3;
        unsigned char p[12];
        if (whole) {
            const unsigned* from = (const unsigned*)(row + (x0 + c - 4) * 3);
            ((unsigned*)p)[0] = from[0];
            ((unsigned*)p)[1] = from[1];
            ((unsigned*)p)[2] = from[2];
        } else {
            for (int k = 0; k < 4; ++k) {
                const unsigned char* from = row + min(max(x0 + c + k - 4, 0), W - 1) * 3;
                for (int channel = 0; channel < 3; ++channel) p[3 * k + channel] = from[channel];
            }
        }
        for (int k = 0; k < 4; ++k)
            grey[r][c + k] =
                (9798 * p[3 * k] + 19235 * p[3 * k + 1] + 3735 * p[3 * k + 2] + 16384) >> 15;
    }
    __syncthreads();
    // A thread walks down 6 rows of a column, so each grey pixel is read three times, not eight.
    if (thread < 198) {
        const int c = thread % 66, first = (thread / 66) * 6, x = x0 + c - 1;
        int h0, h1, s0, s1;
        for (int r = first; r < first + 8; ++r) {
            const int left = grey[r][c + 2], middle = grey[r][c + 3], right = grey[r][c + 4];
            const int h2 = right - left, s2 = left + 2 * middle + right;
            if (r >= first + 2) {
                const int y = y0 + r - 3;
                const bool in = y >= 0 && y < H && x >= 0 && x < W;
                magnitude[r - 2][c] = in ? abs(h0 + 2 * h1 + h2) + abs(s2 - s0) : 0;
            }
            h0 = h1; h1 = h2; s0 = s1; s1 = s2;
        }
    }
    __syncthreads();
    #define GREY(r, c) grey[(r)][(c) + 2]
    #define SOBEL_X(r, c) (GREY(r - 1, c + 1) - GREY(r - 1, c - 1) + GREY(r + 1, c + 1) \\
        - GREY(r + 1, c - 1) + 2 * (GREY(r, c + 1) - GREY(r, c - 1)))
    #define SOBEL_Y(r, c) (GREY(r + 1, c - 1) - GREY(r - 1, c - 1) + GREY(r + 1, c + 1) \\
        - GREY(r - 1, c + 1) + 2 * (GREY(r + 1, c) - GREY(r - 1, c)))
    const int lo = low.data[b], hi = high.data[b];
    for (int job = thread / 32; job < 32; job += 8) {
        int r = job / 2 + 1, c = (job % 2) * 32 + thread % 32 + 1;
        int y = y0 + r - 1;
        int m = magnitude[r][c];
        bool keep = m > lo && y < H && x0 + c - 1 < W;
        if (keep) {
            int dx = SOBEL_X(r + 1, c + 1), dy = SOBEL_Y(r + 1, c + 1);
            int ax = abs(dx), ay = abs(dy) << 15;
            int tan22 = ax * 13573, tan67 = tan22 + (ax << 16);
            if (ay < tan22)
                keep = m > magnitude[r][c - 1] && m >= magnitude[r][c + 1];
            else if (ay > tan67)
                keep = m > magnitude[r - 1][c] && m >= magnitude[r + 1][c];
            else {
                int s = (dx ^ dy) < 0 ? -1 : 1;
                keep = m > magnitude[r - 1][c - s] && m > magnitude[r + 1][c + s];
            }
        }
        unsigned weak = __ballot_sync(0xffffffffu, keep);
        unsigned strong = __ballot_sync(0xffffffffu, keep && m > hi);
        if (thread % 32 == 0 && y < H) {
            size_t at = ((size_t)b * H + y) * words + x0 / 32 + job % 2;
            candidates_out.data[at] = weak;
            strong_out.data[at] = strong;
        }
    }
    __syncthreads();
#endif
"""

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
    const int lane = thread % 32, strip = (H + 31) / 32;
    const int first = min((thread / 32) * strip, H), last = min(first + strip, H);
    const bool mine = lane < n;
    int changed;
    do {
        changed = 0;
        for (int sweep = 0; sweep < 2; ++sweep) {
            const int from = sweep == 0 ? first - 1 : last;
            u64 previous = 0;
            if (mine && first < last && from >= 0 && from < H) previous = reached[from * n + lane];
            for (int k = 0; k < last - first; ++k) {
                const int y = sweep == 0 ? first + k : last - 1 - k;
                u64 c = mine ? allowed[y * n + lane] : 0;
                u64 old = mine ? reached[y * n + lane] : 0;
                u64 left = __shfl_up_sync(all, previous, 1);
                u64 right = __shfl_down_sync(all, previous, 1);
                if (lane == 0) left = 0;
                if (lane == 31) right = 0;
                u64 near = previous | (previous << 1) | (previous >> 1);
                near |= (left >> 63) | (right << 63);
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
                    reached[y * n + lane] = now;
                    changed = 1;
                }
                previous = now;
            }
        }
    } while (__syncthreads_or(changed));
#endif
"""


@wp.func_native(_SUPPRESS)
def _suppress(
    block: int,
    thread: int,
    color: wp.array4d[wp.uint8],
    low: wp.array[wp.int32],
    high: wp.array[wp.int32],
    candidates_out: wp.array3d[wp.uint32],
    strong_out: wp.array3d[wp.uint32],
): ...


@wp.kernel
def canny_suppress(
    color: wp.array4d[wp.uint8],
    low: wp.array[wp.int32],
    high: wp.array[wp.int32],
    candidates_out: wp.array3d[wp.uint32],
    strong_out: wp.array3d[wp.uint32],
):
    """Grey, 3x3 Sobel and non-maximum suppression, a block a tile of 16 rows, 64 columns."""
    i = wp.tid()
    _suppress(i // 256, i % 256, color, low, high, candidates_out, strong_out)


@wp.func_native(_HYSTERESIS)
def _hysteresis(
    block: int,
    thread: int,
    candidates: wp.array3d[wp.uint32],
    strong: wp.array3d[wp.uint32],
    edges_out: wp.array3d[wp.uint32],
): ...


@wp.kernel
def canny_hysteresis(
    candidates: wp.array3d[wp.uint32],
    strong: wp.array3d[wp.uint32],
    edges_out: wp.array3d[wp.uint32],
):
    """Candidates reachable from strong pixels, a block a frame, a warp a strip of rows."""
    i = wp.tid()
    _hysteresis(i // 1024, i % 1024, candidates, strong, edges_out)
