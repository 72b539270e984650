"""Weak and strong edges of Canny, to the bit of ``jaxdet/reference/_canny.py``; for CUDA.

Edge maps are rows of 32-bit words, bit ``i`` of word ``w`` being column ``32 w + i``; rows have an
even number of words, so that they can be read as 64-bit words.
"""

import warp as wp

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

SUPPRESS_BLOCK, SUPPRESS_ROWS, SUPPRESS_COLUMNS = 256, 48, 128
"""Threads of a block, and the tile of an image that a block of ``canny_suppress`` handles."""

_SUPPRESS = """
#if defined(__CUDA_ARCH__)
    const int H = color.shape[1], W = color.shape[2], words = candidates_out.shape[2];
    const int tiles_x = (words + 3) / 4, tiles_y = (H + 47) / 48;
    const int b = block / (tiles_x * tiles_y), tile = block % (tiles_x * tiles_y);
    const int y0 = (tile / tiles_x) * 48, x0 = (tile % tiles_x) * 128, lane = thread % 32;
    const unsigned char* rgb = color.data + (size_t)b * H * W * 3;
    // Grey, four columns a word, with a border of 2 rows and 4 columns; mirrored by clamping.
    __shared__ unsigned grey[52][34];
    // Four columns from x on: three words of memory, where rows begin at whole words; beyond the
    // image they are its last column four times.
    const bool whole = W % 4 == 0;
    auto load = [&](int r, int x, unsigned* raw) {
        const unsigned char* row = rgb + (size_t)min(max(y0 + r - 2, 0), H - 1) * W * 3;
        if (whole) {
            const unsigned* from = (const unsigned*)(row + min(max(x, 0), W - 4) * 3);
            raw[0] = from[0]; raw[1] = from[1]; raw[2] = from[2];
            return;
        }
        unsigned char p[12];
        for (int k = 0; k < 12; ++k) p[k] = row[min(max(x + k / 3, 0), W - 1) * 3 + k % 3];
        for (int k = 0; k < 3; ++k)
            raw[k] = p[4 * k] | p[4 * k + 1] << 8 | p[4 * k + 2] << 16 | p[4 * k + 3] << 24;
    };
    auto save = [&](int r, int c, int x, const unsigned* raw) {
        unsigned p[4] = {
            raw[0],
            __byte_perm(raw[0], raw[1], 0x6543),
            __byte_perm(raw[1], raw[2], 0x5432),
            raw[2] >> 8,
        };
        // Twice the weights, so that grey is the third byte of the sum.
        #pragma unroll
        for (int k = 0; k < 4; ++k)
            p[k] = __dp2a_hi(7470u, p[k], __dp2a_lo(19596u | 38470u << 16, p[k], 32768u));
        const unsigned four = __byte_perm(
            __byte_perm(p[0], p[1], 0x0062), __byte_perm(p[2], p[3], 0x0062), 0x5410);
        const unsigned select = !whole ? 0x3210 : x < 0 ? 0 : x >= W ? 0x3333 : 0x3210;
        grey[r][c] = __byte_perm(four, 0, select);
    };
    // A warp takes rows 8 apart, the loads of several first, so that they are under way together.
    unsigned raw[7][3];
    #pragma unroll
    for (int k = 0; k < 7; ++k) {
        const int r = thread / 32 + 8 * k;
        if (r < 52) load(r, x0 + 4 * lane - 4, raw[k]);
    }
    #pragma unroll
    for (int k = 0; k < 7; ++k) {
        const int r = thread / 32 + 8 * k;
        if (r < 52) save(r, lane, x0 + 4 * lane - 4, raw[k]);
    }
    if (thread < 104) {
        const int c = 32 + thread % 2, x = x0 + 4 * c - 4;
        load(thread / 2, x, raw[0]);
        save(thread / 2, c, x, raw[0]);
    }
    __syncthreads();
    // A warp walks down 6 rows, a lane 4 columns; 32-bit words hold two columns of 16 bits. Pairs
    // 0, 1, 2 are the columns -1 and 0, 1 and 2, 3 and 4; the own pairs are 0 and 1, 2 and 3.
    const unsigned BIAS = 0x04000400u, ONE = 0x00010001u, ANY = 0x7fff7fffu;
    const int first = (thread / 32) * 6, x = x0 + 4 * lane;
    const unsigned least = (low + 1) * ONE, sure = (high + 1) * ONE;
    unsigned inside[3];
    for (int k = 0; k < 3; ++k) {
        const int left = x + 2 * k - 1;
        inside[k] = (left >= 0 && left < W ? 0xffffu : 0u) | (left + 1 < W ? 0xffff0000u : 0u);
    }
    unsigned across[3][3], smooth[3][3], pairs[3][3], own[3][2], size_x[2][2], size_y[2][2];
    unsigned signs[2][2];
    #pragma unroll
    for (int r = 0; r < 10; ++r) {
        const unsigned* from = &grey[first + r][lane];
        const unsigned before = from[0], here = from[1], after = from[2];
        // Neighbouring columns as pairs, from -2 and -1 to 4 and 5.
        const unsigned q0 = __byte_perm(before, 0, 0x4342);
        const unsigned q1 = __byte_perm(__funnelshift_r(before, here, 24), 0, 0x4140);
        const unsigned q2 = __byte_perm(here, 0, 0x4140), q3 = __byte_perm(here, 0, 0x4241);
        const unsigned q4 = __byte_perm(here, 0, 0x4342);
        const unsigned q5 = __byte_perm(__funnelshift_r(here, after, 24), 0, 0x4140);
        const unsigned q6 = __byte_perm(after, 0, 0x4140);
        across[r % 3][0] = q2 + 0x01000100u - q0;
        across[r % 3][1] = q4 + 0x01000100u - q2;
        across[r % 3][2] = q6 + 0x01000100u - q4;
        smooth[r % 3][0] = q0 + 2 * q1 + q2;
        smooth[r % 3][1] = q2 + 2 * q3 + q4;
        smooth[r % 3][2] = q4 + 2 * q5 + q6;
        if (r < 2) continue;
        // Gradients of the row above, plus 1024; their sizes, plus 1024, are the larger of both.
        const int y = y0 + first + r - 3;
        unsigned mx[3], my[3], sign[3];
        #pragma unroll
        for (int k = 0; k < 3; ++k) {
            const unsigned dx =
                across[(r - 2) % 3][k] + 2 * across[(r - 1) % 3][k] + across[r % 3][k];
            const unsigned dy = smooth[r % 3][k] + BIAS - smooth[(r - 2) % 3][k];
            mx[k] = __vmaxu2(dx, 2 * BIAS - dx) - BIAS;
            my[k] = __vmaxu2(dy, 2 * BIAS - dy) - BIAS;
            sign[k] = (dx ^ dy) << 5;
            pairs[r % 3][k] = y >= 0 && y < H ? (mx[k] + my[k]) & inside[k] : 0u;
        }
        #pragma unroll
        for (int k = 0; k < 2; ++k) {
            own[r % 3][k] = __byte_perm(pairs[r % 3][k], pairs[r % 3][k + 1], 0x5432);
            size_x[r % 2][k] = __byte_perm(mx[k], mx[k + 1], 0x5432);
            size_y[r % 2][k] = __byte_perm(my[k], my[k + 1], 0x5432);
            signs[r % 2][k] = __byte_perm(sign[k], sign[k + 1], 0x5432);
        }
        if (r < 4) continue;
        // Suppression in the row above that. The flags are bits 15 and 31: a number up to 32768
        // plus 32767 has bit 15 unless it is 0, and max(a, b) ^ b is 0 where a <= b.
        #define ABOVE(a, b) ((__vmaxu2(a, b) ^ (b)) + ANY)
        const unsigned* up = pairs[(r - 2) % 3];
        const unsigned* at = pairs[(r - 1) % 3];
        const unsigned* down = pairs[r % 3];
        unsigned weak[2], strong[2];
        #pragma unroll
        for (int k = 0; k < 2; ++k) {
            const unsigned m = own[(r - 1) % 3][k];
            const unsigned ax = size_x[(r - 1) % 2][k], ay = size_y[(r - 1) % 2][k];
            // tan(22.5) |dx| in whole numbers: ay < 13573 ax / 32768 exactly where ay <= tan22.
            const unsigned tan22 =
                ((ax & 0xffffu) * 13573u) >> 15 | (((ax >> 16) * 27146u) & 0xffff0000u);
            const unsigned not_flat = ABOVE(ay, tan22), not_steep = ABOVE(tan22 + 2 * ax + ONE, ay);
            const unsigned other = signs[(r - 1) % 2][k];
            const unsigned drop_flat = ABOVE(__vmaxu2(at[k] + ONE, at[k + 1]), m);
            const unsigned drop_steep =
                ABOVE(__vmaxu2(own[(r - 2) % 3][k] + ONE, own[r % 3][k]), m);
            const unsigned drop_fall = ABOVE(__vmaxu2(up[k], down[k + 1]) + ONE, m);
            const unsigned drop_rise = ABOVE(__vmaxu2(up[k + 1], down[k]) + ONE, m);
            const unsigned diagonal = (other & drop_rise) | (~other & drop_fall);
            const unsigned upright = (not_steep & diagonal) | (~not_steep & drop_steep);
            const unsigned drop = (not_flat & upright) | (~not_flat & drop_flat);
            weak[k] = ~(drop | ABOVE(least, m)) & 0x80008000u;
            strong[k] = weak[k] & ~ABOVE(sure, m);
        }
        // Four bits a lane, eight lanes a word.
        auto word_of = [&](unsigned pair0, unsigned pair1) -> unsigned {
            const unsigned spread = pair0 >> 15 | pair1 >> 13;
            unsigned word = ((spread | spread >> 15) & 15u) << (4 * (lane % 8));
            word |= __shfl_xor_sync(0xffffffffu, word, 1);
            word |= __shfl_xor_sync(0xffffffffu, word, 2);
            return word | __shfl_xor_sync(0xffffffffu, word, 4);
        };
        const unsigned weak_word = word_of(weak[0], weak[1]);
        const unsigned strong_word = word_of(strong[0], strong[1]);
        const int row = y - 1, word = x0 / 32 + lane / 8;
        if (lane % 8 == 0 && row < H && word < words) {
            const size_t to = ((size_t)b * H + row) * words + word;
            candidates_out.data[to] = weak_word;
            strong_out.data[to] = strong_word;
        }
    }
#endif
"""


@wp.func_native(_SUPPRESS)
def _suppress(
    block: int,
    thread: int,
    color: wp.array4d[wp.uint8],
    low: int,
    high: int,
    candidates_out: wp.array3d[wp.uint32],
    strong_out: wp.array3d[wp.uint32],
): ...


@wp.kernel(launch_bounds=(256, 4))
def canny_suppress(
    color: wp.array4d[wp.uint8],
    low: int,
    high: int,
    candidates_out: wp.array3d[wp.uint32],
    strong_out: wp.array3d[wp.uint32],
):
    """Grey, 3x3 Sobel and non-maximum suppression, a block a tile of 48 rows, 128 columns.

    The bounds are from -1 to 2047.
    """
    i = wp.tid()
    _suppress(i // 256, i % 256, color, low, high, candidates_out, strong_out)
