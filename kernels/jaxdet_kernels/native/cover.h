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
                if (keep[cell]) list[1 + team.add(list, 1)] = cell;
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

struct CoveredCorners {
    Cover cover;
    int count, slots;         // Corners, and what there is room for.
    const int *u, *v;         // (slots)
    int* words;               // Scratch: 2 slots, bits of the image, a list for each row.
    int* cell_out;            // (slots), the nearest cell over each, of equal ones the first; -1.

    enum { CELL_BITS = 18 };

    void run() const {
        const Team& team = cover.team;
        const int rows = cover.height, across = PixelBits::words(cover.width);
        // Keys depth << CELL_BITS | cell come first, for they have 64 bits.
        unsigned long long* nearest = (unsigned long long*)words;
        int* bits = words + 2 * slots;
        int* first = bits + rows * across;
        int* next = first + rows;
        const unsigned long long nothing = ~0ull;
        for (int i = team.rank; i < rows * across; i += team.size) bits[i] = 0;
        for (int i = team.rank; i < rows; i += team.size) first[i] = -1;
        for (int i = team.rank; i < slots; i += team.size) nearest[i] = nothing;
        cover.gather();
        for (int i = team.rank; i < count; i += team.size) {
            team.set(&bits[v[i] * across + u[i] / 32], 1 << (u[i] & 31));
            next[i] = team.swap(&first[v[i]], i);
        }
        team.sync();
        for (int k = team.rank; k < *cover.list; k += team.size) {
            const int cell = cover.list[1 + k];
            const Cover::Box at = cover.box(cell);
            const unsigned long long key =
                (unsigned long long)cover.z[cell] << CELL_BITS | (unsigned)cell;
            for (int w = at.left / 32; w <= at.right / 32 && at.left <= at.right; ++w) {
                const int part = (int)PixelBits::part(w, at.left, at.right);
                for (int row = at.top; row <= at.bottom; ++row) {
                    if (!(bits[row * across + w] & part)) continue;
                    for (int i = first[row]; i >= 0; i = next[i])
                        if (at.left <= u[i] && u[i] <= at.right) team.least(&nearest[i], key);
                }
            }
        }
        team.sync();
        for (int i = team.rank; i < slots; i += team.size)
            cell_out[i] = nearest[i] == nothing
                              ? -1
                              : (int)(nearest[i] & ((1ull << CELL_BITS) - 1));
    }
};
