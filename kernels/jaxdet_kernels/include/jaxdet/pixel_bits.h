// Bitmap images: rows of 32-bit words; bit i of word w is column 32 w + i. Rows have an even number of
// words, so that they can be read as 64-bit words; bits outside the image are 0.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct PixelBits {
    // Number of words of a row.
    static int words(int width) { return (width + 63) / 64 * 2; }

    // Mask of the bits of word `w` that are columns `from` .. `to`; at least one of these must be in
    // the word.
    static unsigned part(int w, int from, int to) {
        unsigned in = 0xffffffffu;
        if (w == from >> 5) in &= 0xffffffffu << (from & 31);
        if (w == to >> 5) in &= 0xffffffffu >> (31 - (to & 31));
        return in;
    }

    // Mask of the bits of word `w` that are columns of an image.
    static unsigned inside(int w, int width) {
        const int left = width - 32 * w;
        return left >= 32 ? 0xffffffffu : left > 0 ? (1u << left) - 1 : 0;
    }

    // Index of a pixel, in raster order.
    static int place(int x, int y) { return y << 16 | x; }
    static int column(int place) { return place & 0xffff; }
    static int row(int place) { return place >> 16; }

    // Packs eight bytes, each 0 or 1, into bits: the product moves all of them into the highest byte.
    static unsigned packed(unsigned long long bytes) {
        return (unsigned)(bytes * 0x0102040810204080ull >> 56);
    }

    // Index mirrored at the first and last of `n` rows or columns, which are not repeated (reflect-101
    // border).
    static int mirrored(int i, int n) {
        i = i < 0 ? -i : i;
        return i < n ? i : 2 * n - 2 - i;
    }
};

} }  // namespace jaxdet
