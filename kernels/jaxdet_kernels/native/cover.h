// The colour pixels under kept cells, and the nearest kept cell over a corner.
// Twin of `cover` in jaxdet/reference/_cells.py. A cell covers its box, a pixel wider at each side.
#pragma once
#include "pixel_bits.h"

struct Cover {
    Team team;
    int height, width;           // Of the colour image.
    int cells;                   // Of the grid.
    const bool* keep;            // (cells), those that take part.
    const int *z, *low, *high;   // (cells) and (cells, 2): depth, first and last column and row.
    int* list;                   // Scratch: (1 + cells), how many are kept, and which.

    struct Box {
        int left, top, right, bottom;
    };

    Box box(int cell) const {
        const int left = low[2 * cell] - 1, top = low[2 * cell + 1] - 1;
        const int right = high[2 * cell] + 1, bottom = high[2 * cell + 1] + 1;
        return {left < 0 ? 0 : left, top < 0 ? 0 : top, right < width ? right : width - 1,
                bottom < height ? bottom : height - 1};
    }

    // Lists the kept cells, in no order. Most are not kept, so eight are looked at together.
    void gather() const {
        typedef unsigned long long Eight;
        if (team.rank == 0) *list = 0;
        team.sync();
        const int before = (int)((8 - (size_t)keep % 8) % 8), groups = (cells - before) / 8 + 2;
        for (int group = team.rank; group < groups; group += team.size) {
            const int first = before + (group - 1) * 8;
            const bool is_whole = first >= 0 && first + 8 <= cells;
            if (is_whole && *(const Eight*)(keep + first) == 0) continue;
            for (int cell = first < 0 ? 0 : first; cell < first + 8 && cell < cells; ++cell)
                if (keep[cell]) list[1 + team.count(list)] = cell;
        }
        team.sync();
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

// Corners are listed by square tiles of the image; a cell's box asks those that it overlaps.
struct CoveredCorners {
    Cover cover;
    int count, slots;         // Corners, and what there is room for.
    const int *u, *v;         // (slots)
    int* words;               // Scratch: 3 slots, and the tiles.
    const int* label;         // (cells)
    const int *ray_x, *ray_y; // (height, width), fixed point of RAY_BITS.
    // (slots), of each corner: the nearest cell over it, of equal ones the first, and its label, or
    // -1; its depth and coordinates x and y, or 0.
    int *cell_out, *label_out, *x_out, *y_out, *z_out;

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
            const int z = is_covered ? cover.z[cell] : 0, pixel = v[i] * cover.width + u[i];
            cell_out[i] = is_covered ? cell : -1;
            label_out[i] = is_covered ? label[cell] : -1;
            x_out[i] = is_covered ? lateral(ray_x[pixel], z) : 0;
            y_out[i] = is_covered ? lateral(ray_y[pixel], z) : 0;
            z_out[i] = z;
        }
    }

    // As in jaxdet/reference/_features.py.
    static int lateral(int ray, int z) {
        return (int)(((long long)ray * z + (1 << (RAY_BITS - 1))) >> RAY_BITS);
    }
};
