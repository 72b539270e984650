// Grey conversion, gradients and non-maximum suppression of Canny, all in integers. Twin of
// jaxdet/reference/paper/_canny.py. The outputs are two bitmaps (pixel_bits.h): weak edges, above the lower
// threshold, and strong edges, above the higher one. `Hysteresis` adds connected weak edges to strong ones.
#pragma once
#include "pixel_bits.h"
#include "warp.h"

namespace jaxdet { namespace {

// Hysteresis, the last step of Canny: keeps weak edges that are 8-connected to strong ones. Twin of
// `_connected_to` in jaxdet/reference/paper/_canny.py. The images are bitmaps, see pixel_bits.h.
struct Hysteresis {
    typedef unsigned long long Word;

    int height, words;  // rows, and 64-bit words per row
    const Word* weak;   // (height, words): weak edges
    Word* edges;        // (height, words): strong edges; result: all edges connected to them

    // Grows the edges until nothing changes. A thread sweeps down and up a column of words in a strip
    // of rows, so that it can follow lines.
    void run(const Team& team) const {
        const int strips = team.size > words ? team.size / words : 1;
        const int rows = (height + strips - 1) / strips;
        for (bool grown = true; team.any(grown);) {
            grown = false;
            for (int i = team.rank; i < strips * words; i += team.size) {
                const int w = i % words, first = i / words * rows;
                const int end = first + rows < height ? first + rows : height;
                for (int y = first; y < end; ++y) grown |= grow(y, w);
                for (int y = end - 1; y >= first; --y) grown |= grow(y, w);
            }
        }
    }

    // Adds the runs of weak pixels in a word that touch an edge; returns whether there are any.
    bool grow(int y, int w) const {
        const int i = y * words + w;
        Word free = weak[i] & ~edges[i];
        if (!free) return false;
        Word near = 0;
        for (int row = y - 1; row <= y + 1; ++row) {
            if (row < 0 || row >= height) continue;
            const Word* at = edges + row * words + w;
            near |= at[0] | at[0] << 1 | at[0] >> 1;
            if (w > 0) near |= at[-1] >> 63;
            if (w + 1 < words) near |= at[1] << 63;
        }
        Word now = near & free;
        if (!now) return false;
        // The carry of a seed added to its run of ones propagates to the end of the run.
        now |= free & ~(free + now);
        for (int step = 1; step < 64; step *= 2) {
            now |= free & now >> step;
            free &= free >> step;
        }
        edges[i] |= now;
        return true;
    }
};

struct Canny {
    // Weights of colours, and tan(22.5 degrees), with 15 fraction bits.
    enum { RED = 9798, GREEN = 19235, BLUE = 3735, TAN22 = 13573, BITS = 15 };
    // Size of a tile, which is processed in shared memory or the CPU cache. With the border of two
    // pixels that the grey image needs, its rows are a few columns shorter than a multiple of a warp.
    enum { ROWS = 24, COLUMNS = 248 };

    const unsigned char* color;       // (height, width, 3) image, RGB
    int height, width;
    int low, high;                    // from -1 to 2047: thresholds of |dx| + |dy|
    unsigned *weak_out, *strong_out;  // (height, PixelBits::words(width)) bitmaps

    struct Tile {
        short grey[ROWS + 4][COLUMNS + 4];        // begins at row top - 2, column left - 2
        short size[ROWS + 2][COLUMNS + 2];        // |dx| + |dy|, from row top - 1; 0 outside the image
        unsigned char direction[ROWS + 2][COLUMNS + 2];
        alignas(8) unsigned char edge[ROWS][COLUMNS];  // bit 0: weak, bit 1: strong
    };
    // Direction of a pixel's gradient, quantized: along its row, along its column, or along a diagonal.
    enum { FLAT, STEEP, FALLING, RISING };

    void run(const Team& team, Tile& tile) const {
        const int padded = 32 * PixelBits::words(width);
        for (int top = 0; top < height; top += ROWS)
            for (int left = 0; left < padded; left += COLUMNS) {
                const int rows = least(ROWS, height - top), columns = least(COLUMNS, padded - left);
                read_grey(team, tile, top, left, rows + 4, columns + 4);
                team.sync();
                differentiate(team, tile, top, left, rows + 2, columns + 2);
                team.sync();
                suppress(team, tile, rows, columns);
                team.sync();
                write(team, tile, top, left, rows, columns);
            }
        team.sync();
    }

    static int least(int a, int b) { return a < b ? a : b; }
    static int clamped(int i, int n) { return i < 0 ? 0 : least(i, n - 1); }

    static short grey_at(const unsigned char* rgb) {
        const int red = Team::input(rgb), green = Team::input(rgb + 1), blue = Team::input(rgb + 2);
        return (short)((RED * red + GREEN * green + BLUE * blue + (1 << (BITS - 1))) >> BITS);
    }

    // Outside the image the grey value is that of the nearest pixel (replicated border).
    void read_grey(const Team& team, Tile& tile, int top, int left, int rows, int columns) const {
        const Warp warp(team);
        const int first = left < 2 ? 2 - left : 0, end = least(columns, width - left + 2);
        for (int r = warp.index; r < rows; r += warp.count) {
            const unsigned char* line = color + (size_t)clamped(top - 2 + r, height) * width * 3;
            short* grey = tile.grey[r];
            for (int c = first + warp.lane; c < end; c += warp.size)
                grey[c] = grey_at(line + 3 * (left - 2 + c));
            for (int c = warp.lane; c < first; c += warp.size) grey[c] = grey_at(line);
            for (int c = (end > 0 ? end : 0) + warp.lane; c < columns; c += warp.size)
                grey[c] = grey_at(line + 3 * (width - 1));
        }
    }

    // Computes Sobel gradients.
    void differentiate(const Team& team, Tile& tile, int top, int left, int rows,
                       int columns) const {
        const Warp warp(team);
        const int first = left > 0 ? -1 : 0, last = width - left;
        for (int r = warp.index; r < rows; r += warp.count) {
            const short *a = tile.grey[r], *g = tile.grey[r + 1], *b = tile.grey[r + 2];
            const bool inside = top - 1 + r >= 0 && top - 1 + r < height;
            for (int c = warp.lane; c < columns; c += warp.size) {
                const int dx = a[c + 2] - a[c] + 2 * (g[c + 2] - g[c]) + b[c + 2] - b[c];
                const int dy = b[c] + 2 * b[c + 1] + b[c + 2] - a[c] - 2 * a[c + 1] - a[c + 2];
                const int ax = dx < 0 ? -dx : dx, ay = dy < 0 ? -dy : dy;
                tile.size[r][c] = (short)((inside & (c > first) & (c <= last)) ? ax + ay : 0);
                // tan(67.5) = tan(22.5) + 2.
                const int tan22 = ax * TAN22, tan67 = tan22 + (ax << (BITS + 1));
                const int diagonal = (dx ^ dy) < 0 ? RISING : FALLING;
                const int turned = ay << BITS > tan67 ? (int)STEEP : diagonal;
                tile.direction[r][c] = (unsigned char)(ay << BITS < tan22 ? (int)FLAT : turned);
            }
        }
    }

    // Non-maximum suppression: keeps pixels larger than both neighbours in the gradient's direction.
    void suppress(const Team& team, Tile& tile, int rows, int columns) const {
        const Warp warp(team);
        const int low = this->low, high = this->high;  // copies, to avoid reloads after stores
        for (int r = warp.index; r < rows; r += warp.count) {
            const short *a = tile.size[r], *o = tile.size[r + 1], *b = tile.size[r + 2];
            for (int c = warp.lane; c < columns; c += warp.size) {
                // There are no branches, so that the loop can be vectorized. Of two equal neighbours in
                // a row or a column the first is kept, on a diagonal neither.
                const int direction = tile.direction[r + 1][c + 1], m = o[c + 1];
                const int flat = (direction == FLAT) & (m > o[c]) & (m >= o[c + 2]);
                const int steep = (direction == STEEP) & (m > a[c + 1]) & (m >= b[c + 1]);
                const int falling = (direction == FALLING) & (m > a[c]) & (m > b[c + 2]);
                const int rising = (direction == RISING) & (m > a[c + 2]) & (m > b[c]);
                const int weak = (flat | steep | falling | rising) & (m > low);
                tile.edge[r][c] = (unsigned char)(weak + (weak & (m > high)) * 2);
            }
        }
    }

    // Packs the edges into bits, eight pixels per byte, and writes these to the bitmaps.
    void write(const Team& team, const Tile& tile, int top, int left, int rows, int columns) const {
        const Warp warp(team);
        const size_t bytes = 4 * (size_t)PixelBits::words(width);
        for (int r = warp.index; r < rows; r += warp.count) {
            const unsigned long long* edge = (const unsigned long long*)tile.edge[r];
            unsigned char* weak = (unsigned char*)weak_out + (top + r) * bytes + left / 8;
            unsigned char* strong = (unsigned char*)strong_out + (top + r) * bytes + left / 8;
            for (int i = warp.lane; i < columns / 8; i += warp.size) {
                weak[i] = (unsigned char)PixelBits::packed(edge[i] & 0x0101010101010101ull);
                strong[i] = (unsigned char)PixelBits::packed(edge[i] >> 1 & 0x0101010101010101ull);
            }
        }
    }
};

} }  // namespace jaxdet
