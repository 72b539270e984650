// Canny's grey conversion, gradients and non-maximum suppression. Twin of
// jaxdet/reference/_canny.py: all in integers. Output are two images of bits (pixel_bits.h): weak
// edges above the lower bound, and those of them above the higher one. hysteresis.h joins them.
#pragma once
#include "pixel_bits.h"
#include "vectors.h"

namespace jaxdet { namespace {

// Weights of colours, and tan(22.5 degrees), with 15 fraction bits.
struct CannyWeights {
    enum { RED = 9798, GREEN = 19235, BLUE = 3735, TAN22 = 13573, BITS = 15 };
};

#if !defined(__CUDA_ARCH__)
// A frame on the CPU, a few rows at a time in vectors of 16-bit integers: colours are read once and
// nothing but bits is written.
struct CannySuppress {
    enum { MAX_SIZE = 4096, BEFORE = 32, RING = MAX_SIZE + 128, STEP = Vectors::SHORTS,
           PIXELS = Vectors::FLOATS };
    typedef Vectors::Shorts Shorts;

    const unsigned char* color;     // (height, width, 3), RGB.
    int height, width;
    int low, high;                  // From -1 to 2047: thresholds of |dx| + |dy|.
    int stride;                     // At least PixelBits::words(width).
    unsigned *weak_out, *strong_out;  // (height, stride)

    // Rings of rows; column x is at BEFORE + x, and what is outside the image is at both ends.
    struct Rows {
        short grey[3][RING], magnitude[3][RING], dx[2][RING], dy[2][RING];
        // Magnitudes above the lower bound, a bit a pixel, and which words have some.
        unsigned above[2][MAX_SIZE / STEP];
        unsigned long long some[2][MAX_SIZE / STEP / 64];
    };

    // What a column's three pixels add to the gradients of its neighbours.
    struct Column {
        Shorts smooth, change;
    };

    void run() const {
        Rows rows;
        for (int i = 0; i < RING; ++i)
            rows.magnitude[0][i] = rows.magnitude[1][i] = rows.magnitude[2][i] = 0;
        // Columns beyond the image's vectors are read but decide nothing.
        for (int k = 0; k < 3; ++k) {
            for (int i = 0; i < BEFORE; ++i) rows.grey[k][i] = 0;
            for (int i = width + BEFORE; i < RING; ++i) rows.grey[k][i] = 0;
        }
        read(rows, 0);
        for (int y = 0; y <= height; ++y) {
            if (y < height) {
                if (y + 1 < height) read(rows, y + 1);
                differentiate(rows, y);
            }
            // Beside the image and below it there are no gradients.
            for (int x = y < height ? width : 0; x <= width; x += STEP)
                put(rows.magnitude[y % 3], x, (Shorts){});
            if (y > 0) suppress(rows, y - 1);
        }
    }

    void read(Rows& rows, int y) const {
        const unsigned char* from = color + (size_t)y * width * 3;
        short* row = rows.grey[y % 3] + BEFORE;
        const unsigned char* end = color + (size_t)height * width * 3;
        int x = 0;
        // Vectors go on into the next row, but not beyond the image.
        for (; x < width && end - (from + 3 * x) >= Vectors::BYTES; x += PIXELS) {
            __builtin_prefetch(from + 3 * (x + width));
            grey(from + 3 * x, row + x);
        }
        for (; x < width; ++x)
            row[x] = (CannyWeights::RED * from[3 * x] + CannyWeights::GREEN * from[3 * x + 1]
                      + CannyWeights::BLUE * from[3 * x + 2] + (1 << (CannyWeights::BITS - 1)))
                >> CannyWeights::BITS;
        row[-1] = row[0];
        row[width] = row[width - 1];
    }

    // Grey of PIXELS pixels: products of red and green, and of blue and one, are added in pairs.
    static void grey(const unsigned char* from, short* to) {
        typedef short Half __attribute__((vector_size(32), aligned(2), may_alias));
        const Vectors::Bytes& all = *(const Vectors::Bytes*)from;
        const Vectors::Bytes none = {};
        const Vectors::Bytes pairs = __builtin_shufflevector(
            all, none, 0, 64, 1, 64, 3, 64, 4, 64, 6, 64, 7, 64, 9, 64, 10, 64, 12, 64, 13, 64, 15,
            64, 16, 64, 18, 64, 19, 64, 21, 64, 22, 64, 24, 64, 25, 64, 27, 64, 28, 64, 30, 64, 31,
            64, 33, 64, 34, 64, 36, 64, 37, 64, 39, 64, 40, 64, 42, 64, 43, 64, 45, 64, 46, 64);
        const Vectors::Bytes blues = __builtin_shufflevector(
            all, none, 2, 64, 64, 64, 5, 64, 64, 64, 8, 64, 64, 64, 11, 64, 64, 64, 14, 64, 64, 64,
            17, 64, 64, 64, 20, 64, 64, 64, 23, 64, 64, 64, 26, 64, 64, 64, 29, 64, 64, 64, 32, 64,
            64, 64, 35, 64, 64, 64, 38, 64, 64, 64, 41, 64, 64, 64, 44, 64, 64, 64, 47, 64, 64, 64);
        const Shorts& red_green = (const Shorts&)pairs;
        const Vectors::Ints red = __builtin_convertvector(
            __builtin_shufflevector(red_green, red_green, 0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22,
                                    24, 26, 28, 30), Vectors::Ints);
        const Vectors::Ints green = __builtin_convertvector(
            __builtin_shufflevector(red_green, red_green, 1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23,
                                    25, 27, 29, 31), Vectors::Ints);
        const Vectors::Ints blue = (const Vectors::Ints&)blues;
        const int of_red = CannyWeights::RED, of_green = CannyWeights::GREEN;
        const int of_blue = CannyWeights::BLUE, bits = CannyWeights::BITS;
        const Vectors::Ints sum =
            red * of_red + green * of_green + (blue * of_blue + (1 << (bits - 1)));
        *(Half*)to = __builtin_convertvector(sum >> bits, Half);
    }

    void differentiate(Rows& rows, int y) const {
        const short* a = rows.grey[(y > 0 ? y - 1 : 0) % 3] + BEFORE;
        const short* g = rows.grey[y % 3] + BEFORE;
        const short* c = rows.grey[(y + 1 < height ? y + 1 : y) % 3] + BEFORE;
        Column before = column(a, g, c, -STEP), own = column(a, g, c, 0);
        for (int half = 0; half < 2; ++half) {
            const int first = half * 64 * STEP, end = half ? width : 64 * STEP;
            unsigned long long some = 0;  // A local word, as the others are written at once.
            for (int x = first; x < end && x < width; x += STEP) {
                const Column after = column(a, g, c, x + STEP);
                Shorts left, right;
                beside(before.smooth, own.smooth, after.smooth, &left, &right);
                const Shorts dx = right - left;
                beside(before.change, own.change, after.change, &left, &right);
                const Shorts dy = left + own.change * 2 + right;
                const Shorts size = (dx < 0 ? -dx : dx) + (dy < 0 ? -dy : dy);
                put(rows.dx[y % 2], x, dx);
                put(rows.dy[y % 2], x, dy);
                put(rows.magnitude[y % 3], x, size);
                unsigned above = Vectors::bits(size > (short)low);
                if (width - x < STEP) above &= (1u << (width - x)) - 1;
                rows.above[y % 2][x / STEP] = above;
                some |= (unsigned long long)(above != 0) << (x - first) / STEP;
                before = own;
                own = after;
            }
            rows.some[y % 2][half] = some;
        }
    }

    static Column column(const short* a, const short* g, const short* c, int x) {
        return {at(a, x) + at(g, x) * 2 + at(c, x), at(c, x) - at(a, x)};
    }

    // Values of the columns left and right of each.
    static void beside(const Shorts& before, const Shorts& own, const Shorts& after, Shorts* left,
                       Shorts* right) {
        *left = __builtin_shufflevector(
            before, own, 31, 32, 33, 34, 35, 36, 37, 38, 39, 40, 41, 42, 43, 44, 45, 46, 47, 48, 49,
            50, 51, 52, 53, 54, 55, 56, 57, 58, 59, 60, 61, 62);
        *right = __builtin_shufflevector(
            own, after, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21,
            22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32);
    }

    // Row y, whose neighbours' magnitudes are known.
    void suppress(const Rows& rows, int y) const {
        unsigned* weak = weak_out + (size_t)y * stride;
        unsigned* strong = strong_out + (size_t)y * stride;
        for (int w = 0; w < stride; ++w) weak[w] = strong[w] = 0;
        for (int half = 0; half < 2; ++half)
            for (unsigned long long left = rows.some[y % 2][half]; left; left &= left - 1) {
                const int w = half * 64 + __builtin_ctzll(left), x = w * STEP;
                weak[w] = rows.above[y % 2][w] & maxima(rows, y, x);
                const short* own = rows.magnitude[y % 3] + BEFORE;
                strong[w] = weak[w] & Vectors::bits(at(own, x) > (short)high);
            }
    }

    // Those of row y's pixels from column x on that are larger than both beside them along the
    // gradient.
    static unsigned maxima(const Rows& rows, int y, int x) {
        const short* up = rows.magnitude[(y + 2) % 3] + BEFORE;
        const short* own = rows.magnitude[y % 3] + BEFORE;
        const short* down = rows.magnitude[(y + 1) % 3] + BEFORE;
        const Shorts dx = at(rows.dx[y % 2] + BEFORE, x), dy = at(rows.dy[y % 2] + BEFORE, x);
        const Shorts ax = dx < 0 ? -dx : dx, ay = dy < 0 ? -dy : dy, m = at(own, x);
        // dy 2^15 < 13573 dx exactly where dy <= floor(13573 dx / 2^15) and dx is not 0, and
        // above tan 67.5 dx = (tan 22.5 + 2) dx likewise.
        const Vectors::Wide product =
            __builtin_convertvector(ax, Vectors::Wide) * (2 * CannyWeights::TAN22) >> 16;
        const Shorts tan22 = __builtin_convertvector(product, Shorts);
        const unsigned flat = Vectors::bits(ay <= tan22) & Vectors::bits(ax != 0);
        const unsigned steep = Vectors::bits(ay > tan22 + ax * 2);
        const unsigned rises = Vectors::bits((dx ^ dy) < 0);
        const unsigned horizontal =
            Vectors::bits(m > at(own, x - 1)) & Vectors::bits(m >= at(own, x + 1));
        const unsigned vertical = Vectors::bits(m > at(up, x)) & Vectors::bits(m >= at(down, x));
        const unsigned falling =
            Vectors::bits(m > at(up, x - 1)) & Vectors::bits(m > at(down, x + 1));
        const unsigned rising =
            Vectors::bits(m > at(up, x + 1)) & Vectors::bits(m > at(down, x - 1));
        const unsigned diagonal = (rises & rising) | (~rises & falling);
        return (flat & horizontal) | (steep & vertical) | (~(flat | steep) & diagonal);
    }

    static const Shorts& at(const short* row, int x) { return *(const Shorts*)(row + x); }
    static void put(short* row, int x, const Shorts& values) {
        *(Shorts*)(row + BEFORE + x) = values;
    }
};
#else
// A tile of a frame on CUDA, by a block of 256 threads.
struct CannySuppressTile {
    enum {
        THREADS = 256, WARPS = THREADS / 32,
        ROWS = 48, COLUMNS = 128,         // Of the tile.
        RING = 2,                         // Rows of grey around it, and four columns.
        GREY_ROWS = ROWS + 2 * RING, GREY_WORDS = COLUMNS / 4 + 2,
        LOADS = (GREY_ROWS + WARPS - 1) / WARPS,
    };
    int thread;
    const unsigned char* color;       // (height, width, 3), RGB.
    int height, width;
    int top, left;                    // The tile's first row and column.
    int low, high;                    // From -1 to 2047: thresholds of |dx| + |dy|.
    unsigned *weak_out, *strong_out;  // (height, PixelBits::words(width))

    // The same value for both of two columns, 16 bits each.
    static unsigned both(unsigned value) { return value * 0x00010001u; }

    // Flags of both columns, bits 15 and 31: whether a > b. Numbers are at most 32768, which plus
    // 32767 has bit 15 unless it is 0; max(a, b) ^ b is 0 where a <= b.
    static unsigned above(unsigned a, unsigned b) { return (__vmaxu2(a, b) ^ b) + both(0x7fff); }

    // Three words of memory, four columns from x on; beyond the image they are its last column.
    void load(int row, int x, unsigned* raw) const {
        const int y = min(max(top + row - RING, 0), height - 1);
        const unsigned char* line = color + (size_t)y * width * 3;
        if (width % 4 == 0) {  // Rows begin at whole words.
            const unsigned* from = (const unsigned*)(line + min(max(x, 0), width - 4) * 3);
            for (int k = 0; k < 3; ++k) raw[k] = from[k];
            return;
        }
        unsigned char p[12];
        for (int k = 0; k < 12; ++k) p[k] = line[min(max(x + k / 3, 0), width - 1) * 3 + k % 3];
        for (int k = 0; k < 3; ++k)
            raw[k] = p[4 * k] | p[4 * k + 1] << 8 | p[4 * k + 2] << 16 | p[4 * k + 3] << 24;
    }

    // Grey of those four columns, a byte each; borders are replicated.
    unsigned grey_of(const unsigned* raw, int x) const {
        unsigned p[4] = {
            raw[0],
            __byte_perm(raw[0], raw[1], 0x6543),
            __byte_perm(raw[1], raw[2], 0x5432),
            raw[2] >> 8,
        };
        // Twice the weights, so that grey is the third byte of the sum.
        const unsigned red_green =
            (unsigned)(2 * CannyWeights::RED) | (unsigned)(2 * CannyWeights::GREEN) << 16;
        #pragma unroll
        for (int k = 0; k < 4; ++k)
            p[k] = __dp2a_hi((unsigned)(2 * CannyWeights::BLUE), p[k],
                             __dp2a_lo(red_green, p[k], 1u << CannyWeights::BITS));
        const unsigned four = __byte_perm(
            __byte_perm(p[0], p[1], 0x0062), __byte_perm(p[2], p[3], 0x0062), 0x5410);
        if (width % 4 != 0) return four;
        return __byte_perm(four, 0, x < 0 ? 0 : x >= width ? 0x3333 : 0x3210);
    }

    void run() const {
        __shared__ unsigned grey[GREY_ROWS][GREY_WORDS];
        const int lane = thread % 32, words = PixelBits::words(width);
        // A warp takes rows WARPS apart, all loads first, so that they are under way together.
        unsigned raw[LOADS][3];
        #pragma unroll
        for (int k = 0; k < LOADS; ++k) {
            const int r = thread / 32 + WARPS * k;
            if (r < GREY_ROWS) load(r, left + 4 * lane - 4, raw[k]);
        }
        #pragma unroll
        for (int k = 0; k < LOADS; ++k) {
            const int r = thread / 32 + WARPS * k;
            if (r < GREY_ROWS) grey[r][lane] = grey_of(raw[k], left + 4 * lane - 4);
        }
        if (thread < 2 * GREY_ROWS) {
            const int c = 32 + thread % 2, x = left + 4 * c - 4;
            load(thread / 2, x, raw[0]);
            grey[thread / 2][c] = grey_of(raw[0], x);
        }
        __syncthreads();
        // A warp walks down its rows, a lane 4 columns; 32-bit words hold two columns of 16 bits.
        // Pairs 0, 1, 2 are the columns -1 and 0, 1 and 2, 3 and 4; own pairs 0 and 1, 2 and 3.
        const int walked = ROWS / WARPS, first = thread / 32 * walked, x = left + 4 * lane;
        const unsigned bias = both(1024), one = both(1);
        const unsigned least = both(low + 1), sure = both(high + 1);
        unsigned inside[3];
        for (int k = 0; k < 3; ++k) {
            const int c = x + 2 * k - 1;
            inside[k] = (c >= 0 && c < width ? 0xffffu : 0u) | (c + 1 < width ? 0xffff0000u : 0u);
        }
        unsigned across[3][3], smooth[3][3], pairs[3][3], own[3][2], size_x[2][2], size_y[2][2];
        unsigned signs[2][2];
        #pragma unroll
        for (int r = 0; r < walked + 4; ++r) {
            const unsigned* from = &grey[first + r][lane];
            const unsigned before = from[0], here = from[1], after = from[2];
            // Neighbouring columns as pairs, from -2 and -1 to 4 and 5.
            const unsigned q0 = __byte_perm(before, 0, 0x4342);
            const unsigned q1 = __byte_perm(__funnelshift_r(before, here, 24), 0, 0x4140);
            const unsigned q2 = __byte_perm(here, 0, 0x4140), q3 = __byte_perm(here, 0, 0x4241);
            const unsigned q4 = __byte_perm(here, 0, 0x4342);
            const unsigned q5 = __byte_perm(__funnelshift_r(here, after, 24), 0, 0x4140);
            const unsigned q6 = __byte_perm(after, 0, 0x4140);
            across[r % 3][0] = q2 + both(256) - q0;
            across[r % 3][1] = q4 + both(256) - q2;
            across[r % 3][2] = q6 + both(256) - q4;
            smooth[r % 3][0] = q0 + 2 * q1 + q2;
            smooth[r % 3][1] = q2 + 2 * q3 + q4;
            smooth[r % 3][2] = q4 + 2 * q5 + q6;
            if (r < 2) continue;
            // Gradients of the row above, plus 1024; their sizes, plus 1024, are the larger of
            // both signs.
            const int y = top + first + r - RING - 1;
            unsigned mx[3], my[3], sign[3];
            #pragma unroll
            for (int k = 0; k < 3; ++k) {
                const unsigned dx =
                    across[(r - 2) % 3][k] + 2 * across[(r - 1) % 3][k] + across[r % 3][k];
                const unsigned dy = smooth[r % 3][k] + bias - smooth[(r - 2) % 3][k];
                mx[k] = __vmaxu2(dx, 2 * bias - dx) - bias;
                my[k] = __vmaxu2(dy, 2 * bias - dy) - bias;
                sign[k] = (dx ^ dy) << 5;
                pairs[r % 3][k] = y >= 0 && y < height ? (mx[k] + my[k]) & inside[k] : 0u;
            }
            #pragma unroll
            for (int k = 0; k < 2; ++k) {
                own[r % 3][k] = __byte_perm(pairs[r % 3][k], pairs[r % 3][k + 1], 0x5432);
                size_x[r % 2][k] = __byte_perm(mx[k], mx[k + 1], 0x5432);
                size_y[r % 2][k] = __byte_perm(my[k], my[k + 1], 0x5432);
                signs[r % 2][k] = __byte_perm(sign[k], sign[k + 1], 0x5432);
            }
            if (r < 4) continue;
            // Suppression in the row above that.
            const unsigned* up = pairs[(r - 2) % 3];
            const unsigned* at = pairs[(r - 1) % 3];
            const unsigned* down = pairs[r % 3];
            unsigned weak[2], strong[2];
            #pragma unroll
            for (int k = 0; k < 2; ++k) {
                const unsigned m = own[(r - 1) % 3][k];
                const unsigned ax = size_x[(r - 1) % 2][k], ay = size_y[(r - 1) % 2][k];
                // tan(22.5) |dx| in whole numbers: ay < 13573 ax / 32768 where ay <= tan22.
                const unsigned tan22 =
                    ((ax & 0xffffu) * CannyWeights::TAN22) >> CannyWeights::BITS
                    | (((ax >> 16) * (2 * CannyWeights::TAN22)) & 0xffff0000u);
                const unsigned not_flat = above(ay, tan22);
                const unsigned not_steep = above(tan22 + 2 * ax + one, ay);
                const unsigned rises = signs[(r - 1) % 2][k];
                const unsigned drop_flat = above(__vmaxu2(at[k] + one, at[k + 1]), m);
                const unsigned drop_steep =
                    above(__vmaxu2(own[(r - 2) % 3][k] + one, own[r % 3][k]), m);
                const unsigned drop_fall = above(__vmaxu2(up[k], down[k + 1]) + one, m);
                const unsigned drop_rise = above(__vmaxu2(up[k + 1], down[k]) + one, m);
                const unsigned diagonal = (rises & drop_rise) | (~rises & drop_fall);
                const unsigned upright = (not_steep & diagonal) | (~not_steep & drop_steep);
                const unsigned drop = (not_flat & upright) | (~not_flat & drop_flat);
                weak[k] = ~(drop | above(least, m)) & both(0x8000);
                strong[k] = weak[k] & ~above(sure, m);
            }
            const unsigned weak_word = word_of(weak, lane), strong_word = word_of(strong, lane);
            const int row = y - 1, word = left / 32 + lane / 8;
            if (lane % 8 == 0 && row < height && word < words) {
                weak_out[(size_t)row * words + word] = weak_word;
                strong_out[(size_t)row * words + word] = strong_word;
            }
        }
    }

    // Four bits a lane, eight lanes a word; all lanes ask.
    static unsigned word_of(const unsigned* flags, int lane) {
        const unsigned spread = flags[0] >> 15 | flags[1] >> 13;
        unsigned word = ((spread | spread >> 15) & 15u) << (4 * (lane % 8));
        word |= __shfl_xor_sync(0xffffffffu, word, 1);
        word |= __shfl_xor_sync(0xffffffffu, word, 2);
        return word | __shfl_xor_sync(0xffffffffu, word, 4);
    }
};
#endif

} }  // namespace jaxdet
