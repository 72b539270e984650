"""Shi-Tomasi corners of edge maps, to the bit of ``jaxdet/reference/_corners.py``; for CUDA.

On an edge image a 3x3 window has 512 patterns, so gradients and their products are look-ups. The
running sums in float64 follow OpenCV's box filter row by row, for a column a thread.
"""

import warp as wp

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

EIGENVALUE_BLOCK = 128
"""Threads of a block."""

_EIGENVALUE = """
#if defined(__CUDA_ARCH__)
    const int H = strength_out.shape[1], W = strength_out.shape[2], words = edges.shape[2];
    const int columns = (W + 127) / 128, b = block / columns, x = (block % columns) * 128 + thread;
    __shared__ double xx[512], xy[512], yy[512];
    __shared__ int best;
    const double scale = 1.0 / (4.0 * 3.0 * 255.0);
    const float k1 = (float)scale, k0 = (float)(2.0 * scale);
    if (thread == 0) best = (int)0x80000000;
    for (int i = thread; i < 512; i += 128) {
        float p[9];
        for (int j = 0; j < 9; ++j) p[j] = (i >> j) & 1 ? 255.0f : 0.0f;
        float s0 = p[2] - p[0], s1 = p[5] - p[3], s2 = p[8] - p[6];
        float dx = __fmaf_rn(s0 + s2, k1, __fmul_rn(s1, k0));
        float top = __fmaf_rn(p[2], k1, __fmaf_rn(p[1], k0, __fmul_rn(p[0], k1)));
        float bottom = __fmaf_rn(p[8], k1, __fmaf_rn(p[7], k0, __fmul_rn(p[6], k1)));
        float dy = __fsub_rn(bottom, top);
        xx[i] = (double)__fmul_rn(dx, dx);
        xy[i] = (double)__fmul_rn(dx, dy);
        yy[i] = (double)__fmul_rn(dy, dy);
    }
    __syncthreads();
    const unsigned* rows = edges.data + (size_t)b * H * words;
    // Each warp keeps the last 64 rows of its word and the words beside it.
    __shared__ unsigned strips[4][64][3];
    const int lane = thread % 32, own = x / 32;
    unsigned (*strip)[3] = strips[thread / 32];
    typedef unsigned long long u64;
    u64 occupied = 0;  // Bit i: row 32 * chunk + i has an edge near the warp's columns.
    auto fill = [&](int chunk) {
        const int y = 32 * chunk + lane;
        unsigned beside[3] = {0, 0, 0};
        for (int k = 0; k < 3; ++k)
            if (y < H && own + k >= 1 && own + k - 1 < words)
                beside[k] = rows[(size_t)y * words + own + k - 1];
        __syncwarp();
        for (int k = 0; k < 3; ++k) strip[y & 63][k] = beside[k];
        const bool near = (beside[0] >> 30) | beside[1] | (beside[2] & 3);
        occupied = (occupied >> 32) | ((u64)__ballot_sync(0xffffffffu, near) << 32);
        __syncwarp();
    };
    const bool inner = x >= 2 && x < W - 2;
    // The 3x3 bits around column x and those left and right of it, of one row: three times three
    // bits, mirrored at the image's border; a mirrored window is a window of the image.
    auto window = [&](int y) -> unsigned {
        const unsigned* near = strip[y & 63] + (lane >= 2);
        const unsigned bits = __funnelshift_r(near[0], near[1], (lane - 2) & 31);
        if (inner) return (bits & 7) | ((bits & 14) << 2) | ((bits & 28) << 4);
        unsigned all = 0;
        for (int k = 0; k < 3 && x < W; ++k) {
            int c = x + k - 1;
            c = c < 0 ? 1 : c >= W ? W - 2 : c;
            const int left = (c == 0 ? 1 : c - 1) - x + 2;
            const int right = (c == W - 1 ? W - 2 : c + 1) - x + 2;
            const unsigned three = ((bits >> left) & 1) | (((bits >> (c - x + 2)) & 1) << 1)
                | (((bits >> right) & 1) << 2);
            all |= three << (3 * k);
        }
        return all;
    };
    // Windows of the rows around the one that is added next, then the sums of three columns.
    unsigned above = 0, middle = 0, below = 0;
    double ring[3][3], total[3];
    auto add = [&](double* r, unsigned above, unsigned middle, unsigned below) {
        const int p0 = (above & 7) | ((middle & 7) << 3) | ((below & 7) << 6);
        const int p1 = ((above >> 3) & 7) | (middle & 56) | ((below & 56) << 3);
        const int p2 = (above >> 6) | ((middle >> 6) << 3) | (below & 448);
        r[0] = __dadd_rn(__dadd_rn(xx[p0], xx[p1]), xx[p2]);
        r[1] = __dadd_rn(__dadd_rn(xy[p0], xy[p1]), xy[p2]);
        r[2] = __dadd_rn(__dadd_rn(yy[p0], yy[p1]), yy[p2]);
    };
    int strongest = (int)0x80000000, ordered = 0, peak = 0, last = -1;
    float e = 0.0f;
    float* out = strength_out.data + (size_t)b * H * W + x;
    const bool* may = mask.data + (size_t)b * H * W + x;
    int* peaks = peak_out.data + (size_t)b * H * words + own;
    // Maxima above 0 are gathered by each warp and listed some at a time.
    __shared__ int gathered[4][64];
    int* places = gathered[thread / 32];
    int waiting = 0;
    auto list = [&]() {
        const int slots = list_out.shape[1];
        int at = lane == 0 ? atomicAdd(&count_out.data[b], waiting) : 0;
        at = __shfl_sync(0xffffffffu, at, 0);
        __syncwarp();
        for (int k = lane; k < waiting; k += 32)
            if (at + k < slots) list_out.data[(size_t)b * slots + at + k] = places[k];
        __syncwarp();
        waiting = 0;
    };
    float e1 = 0.0f, e2 = 0.0f;  // The strengths one and two rows above.
    auto search = [&](int y) {
        // Is row y - 1 a maximum? Beyond the warp's columns nobody looks yet.
        const float tallest = fmaxf(fmaxf(e2, e1), e);
        const float left = __shfl_up_sync(0xffffffffu, tallest, 1);
        const float right = __shfl_down_sync(0xffffffffu, tallest, 1);
        const bool found = y >= 2 && x >= 1 && x < W - 1 && e1 > 0.0f
            && e1 >= fmaxf(fmaxf(left, right), tallest);
        const unsigned votes = __ballot_sync(0xffffffffu, found);
        if (votes) {
            if (found) places[waiting + __popc(votes & ((1u << lane) - 1u))] = (y - 1) * W + x;
            waiting += __popc(votes);
            if (waiting > 32) list();
        }
        e2 = e1;
        e1 = e;
    };
    auto store = [&](int y) {
        if (x < W) {
            out[(size_t)y * W] = e;
            if (ordered > strongest && (!masked || may[(size_t)y * W])) strongest = ordered;
        }
        if (lane == 0 && own < words) peaks[(size_t)y * words] = peak;
    };
    fill(0);
    for (int y = 0; y < H;) {
        const int chunk = y / 32, end = min(32 * chunk + 32, H);
        fill(chunk + 1);
        if (y == 0) {
            // Row -1 is row 1, and the rows around row 0 are row 1 twice.
            above = window(0); middle = window(1); below = window(2);
            add(ring[0], above, middle, below);
            add(ring[1], middle, above, middle);
            for (int k = 0; k < 3; ++k) total[k] = __dadd_rn(ring[0][k], ring[1][k]);
        }
        while (y < end) {
            const int ahead = __ffsll(occupied >> (y - 32 * chunk));
            if (y - last > 3 && (ahead == 0 || ahead > 3)) {
                // No edge from three rows above to two rows below: adding and taking away zeros
                // changes neither the sums nor the strength.
                const int stop = ahead == 0 ? end : min(end, y + ahead - 3);
                if (__any_sync(0xffffffffu, e > 0.0f))
                    for (int row = y; row < stop; ++row) search(row);
                for (; y < stop; ++y) store(y);
                e1 = e; e2 = e;
                above = 0; middle = 0;
                below = y + 2 < H ? window(y + 2) : 0;
                continue;
            }
            if (ahead == 1) last = y;
            // Beyond the last row the rows come back: H is H - 2, and around it are its own.
            const unsigned coming = y + 3 < H ? window(y + 3) : middle;
            if (y < H - 1) add(ring[2], above, middle, below);
            else for (int k = 0; k < 3; ++k) ring[2][k] = ring[0][k];
            float s[3];
            #pragma unroll
            for (int k = 0; k < 3; ++k) {
                const double sum = __dadd_rn(total[k], ring[2][k]);
                s[k] = __double2float_rn(sum);
                total[k] = __dsub_rn(sum, ring[0][k]);
                ring[0][k] = ring[1][k];
                ring[1][k] = ring[2][k];
            }
            const float a = __fmul_rn(0.5f, s[0]), c = __fmul_rn(0.5f, s[2]), t = __fsub_rn(a, c);
            const float root = __fsqrt_rn(__fadd_rn(__fmul_rn(t, t), __fmul_rn(s[1], s[1])));
            e = __fsub_rn(__fadd_rn(a, c), root);
            const int bits = __float_as_int(e);
            ordered = bits < 0 ? bits ^ 0x7fffffff : bits;
            // The strongest of each word lets the search for maxima skip what is flat.
            peak = __reduce_max_sync(0xffffffffu, x < W ? ordered : (int)0x80000000);
            store(y);
            search(y);
            above = middle; middle = below; below = coming;
            ++y;
        }
    }
    list();
    atomicMax(&best, strongest);
    __syncthreads();
    if (thread == 0) atomicMax(&best_out.data[b], best);
#endif
"""


@wp.func_native(_EIGENVALUE)
def _eigenvalue(
    block: int,
    thread: int,
    edges: wp.array3d[wp.uint32],
    mask: wp.array3d[wp.bool],
    masked: int,
    best_out: wp.array[wp.int32],
    count_out: wp.array[wp.int32],
    strength_out: wp.array3d[wp.float32],
    peak_out: wp.array3d[wp.int32],
    list_out: wp.array2d[wp.int32],
): ...


@wp.kernel(launch_bounds=(128, 7))
def corners_eigenvalue(
    edges: wp.array3d[wp.uint32],
    mask: wp.array3d[wp.bool],
    masked: int,
    best_out: wp.array[wp.int32],
    count_out: wp.array[wp.int32],
    strength_out: wp.array3d[wp.float32],
    peak_out: wp.array3d[wp.int32],
    list_out: wp.array2d[wp.int32],
):
    """Minimum eigenvalue of an edge image, a thread a column; the strongest allowed one.

    ``mask`` is read where ``masked`` is not 0; else every pixel is allowed. Of each frame the 3x3
    maxima above 0 are listed, in no order, and counted, maybe more than the list holds; among
    them are pixels at the sides of a word that only its own columns make maxima.
    """
    i = wp.tid()
    _eigenvalue(
        i // 128,
        i % 128,
        edges,
        mask,
        masked,
        best_out,
        count_out,
        strength_out,
        peak_out,
        list_out,
    )
