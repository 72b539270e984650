// The colour pixels under kept cells, the nearest kept cell over a corner, and a sample of the cells.
// Twin of `cover` in jaxdet/reference/_cells.py and of `_points` in jaxdet/reference/_detect.py. A
// cell covers its box, a pixel wider at each side.
#pragma once
#include "bits.h"
#include "lanes.h"
#include "pixel_bits.h"
#include "pixel_pair.h"

struct Cover {
    Team team;
    int height, width;           // Of the colour image.
    int cells;                   // Of the grid.
    const bool *keep, *in_view;  // (cells)
    const int *z, *low, *high;   // (cells): depth; a `PixelPair` each, first and last pixel.
    const int* range;            // (2), least and largest depth; of kept cells only the second counts.
    int* list;                   // Scratch: (1 + cells), how many take part, and which.

    struct Box {
        int left, top, right, bottom;
    };

    Box box(int cell) const {
        const PixelPair first(low[cell]), last(high[cell]);
        const int left = first.column() - 1, top = first.row() - 1;
        const int right = last.column() + 1, bottom = last.row() + 1;
        return {left < 0 ? 0 : left, top < 0 ? 0 : top, right < width ? right : width - 1,
                bottom < height ? bottom : height - 1};
    }

    // Whether any cell in view is in range; all threads get it.
    bool any_in_range() const {
        enum { AHEAD = 64 };
        for (int first = 0; first < cells; first += AHEAD * team.size) {
            const int last = first + AHEAD * team.size < cells ? first + AHEAD * team.size : cells;
            bool some = false;
            for (int i = first + team.rank; i < last; i += team.size)
                some |= in_view[i] & (z[i] >= range[0]) & (z[i] <= range[1]);
            if (team.any(some)) return true;
        }
        return false;
    }

    bool takes_part(int cell) const {
        return keep[cell] & in_view[cell] & (z[cell] <= range[1]);
    }

    // Lists the cells that take part, in no order.
    void gather() const {
#if defined(__CUDA_ARCH__)
        // Most are not kept, so eight are looked at together.
        typedef unsigned long long Eight;
        if (team.rank == 0) *list = 0;
        team.sync();
        const int before = (int)((8 - (size_t)keep % 8) % 8), groups = (cells - before) / 8 + 2;
        for (int group = team.rank; group < groups; group += team.size) {
            const int first = before + (group - 1) * 8;
            const bool is_whole = first >= 0 && first + 8 <= cells;
            if (is_whole && *(const Eight*)(keep + first) == 0) continue;
            for (int cell = first < 0 ? 0 : first; cell < first + 8 && cell < cells; ++cell)
                if (keep[cell] && takes_part(cell)) list[1 + team.count(list)] = cell;
        }
        team.sync();
#else
        int n = 0;
        for (int first = 0; first < cells; first += BitRows::WIDTH) {
            unsigned char taken[BitRows::WIDTH];
            const int left = cells - first;
            const int wide = left < BitRows::WIDTH ? left : (int)BitRows::WIDTH;
            for (int k = 0; k < wide; ++k) taken[k] = takes_part(first + k);
            for (unsigned those = BitRows::packed(taken, 0, wide); those; those &= those - 1)
                list[1 + n++] = first + BitRows::first(those);
        }
        *list = n;
#endif
    }

    // Whether each pixel lies under a kept cell: (height, PixelBits::words(width)).
    void paint(unsigned* bits) const {
        const int words = PixelBits::words(width);
        for (int i = team.rank; i < height * words; i += team.size) bits[i] = 0;
        gather();
        for (int i = team.rank; i < *list; i += team.size) {
            const Box at = box(list[1 + i]);
            for (int w = at.left / 32; w <= at.right / 32 && at.left <= at.right; ++w)
                for (int v = at.top; v <= at.bottom; ++v)
                    team.set((int*)&bits[v * words + w],
                             (int)PixelBits::part(w, at.left, at.right));
        }
    }
};

// What is told of the features of a frame, each by slot.
struct FeatureSlots {
    int *u, *v, *x, *y, *z, *label;
    bool *valid, *kept;
    int most;  // Labels from here on become -1.

    void put(int i, int column, int row, bool is_valid) const {
        u[i] = column;
        v[i] = row;
        valid[i] = is_valid;
    }

    void place(int i, int right, int down, int depth, int own, bool is_kept) const {
        x[i] = right;
        y[i] = down;
        z[i] = depth;
        label[i] = own < most ? own : -1;
        kept[i] = is_kept;
    }
};

// Every second cell of every second row.
struct SampledCells {
    Cover cover;
    int rows, columns;
    const int *x, *y, *label;  // (cells)
    FeatureSlots out;
    int first;                 // Its slot of the first of them.

    void run() const {
        const Lanes lanes(cover.team);
        const int across = columns / 2;
        for (int row = lanes.index; row < rows / 2; row += lanes.count) {
            const int from = (2 * row + 1) * columns + 1, to = first + row * across;
#if defined(__clang__)
#pragma clang loop vectorize(assume_safety)
#endif
            for (int i = lanes.rank; i < across; i += Lanes::size) {
                const int k = from + 2 * i;
                const bool seen = cover.in_view[k], is_kept = seen & cover.keep[k];
                const int right = x[k], down = y[k], depth = cover.z[k], own = label[k];
                const PixelPair low(cover.low[k]), high(cover.high[k]);
                out.put(to + i, (low.column() + high.column()) >> 1, (low.row() + high.row()) >> 1,
                        is_kept);
                out.place(to + i, right, down, depth, seen ? own : -1, is_kept);
            }
        }
    }
};

// Corners are listed by square tiles of the image; a cell's box asks those that it overlaps.
struct CoveredCorners {
    Cover cover;
    int count, slots;         // Corners, and what there is room for.
    const int *u, *v;         // (slots)
    int* words;               // Scratch: 3 slots, and the tiles.
    const int* label;         // (cells)
    const int *ray_x, *ray_y; // (height, width), fixed point of RAY_BITS.
    // Of each corner: the depth and the label of the nearest cell over it, of equal ones the first,
    // and its coordinates; 0 and -1 without one.
    FeatureSlots out;

    enum { CELL_BITS = 18, TILE = 8, RAY_BITS = 20 };

    void run() const {
        const Team& team = cover.team;
        const int across = (cover.width + TILE - 1) / TILE;
        const int tiles = (cover.height + TILE - 1) / TILE * across;
        // Keys depth << CELL_BITS | cell come first, for they have 64 bits.
        unsigned long long* nearest = (unsigned long long*)words;
        int *next = words + 2 * slots, *first = next + slots;
        const unsigned long long nothing = ~0ull;
        for (int i = team.rank; i < tiles; i += team.size) first[i] = -1;
        for (int i = team.rank; i < slots; i += team.size) nearest[i] = nothing;
        cover.gather();
        for (int i = team.rank; i < count; i += team.size)
            next[i] = team.swap(&first[v[i] / TILE * across + u[i] / TILE], i);
        team.sync();
        for (int k = team.rank; k < *cover.list; k += team.size) {
            const int cell = cover.list[1 + k];
            const Cover::Box at = cover.box(cell);
            if (at.left > at.right || at.top > at.bottom) continue;
            const unsigned long long key =
                (unsigned long long)cover.z[cell] << CELL_BITS | (unsigned)cell;
            for (int row = at.top / TILE; row <= at.bottom / TILE; ++row)
                for (int column = at.left / TILE; column <= at.right / TILE; ++column)
                    for (int i = first[row * across + column]; i >= 0; i = next[i]) {
                        const bool is_under = (at.left <= u[i]) & (u[i] <= at.right) &
                            (at.top <= v[i]) & (v[i] <= at.bottom);
                        if (is_under) team.least(&nearest[i], key);
                    }
        }
        team.sync();
        for (int i = team.rank; i < slots; i += team.size) {
            const bool is_covered = nearest[i] != nothing;
            const int cell = (int)(nearest[i] & ((1ull << CELL_BITS) - 1));
            const int depth = is_covered ? cover.z[cell] : 0, pixel = v[i] * cover.width + u[i];
            out.put(i, u[i], v[i], i < count);
            out.place(i, lateral(ray_x[pixel], depth), lateral(ray_y[pixel], depth), depth,
                      is_covered ? label[cell] : -1, is_covered);
        }
    }

    // As in jaxdet/reference/_features.py.
    static int lateral(int ray, int z) {
        return (int)(((long long)ray * z + (1 << (RAY_BITS - 1))) >> RAY_BITS);
    }
};
