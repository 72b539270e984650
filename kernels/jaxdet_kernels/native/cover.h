// The colour pixels under kept cells, and the nearest kept cell over a corner.
// Twin of `cover` in jaxdet/reference/_cells.py. A cell covers its box, a pixel wider at each side.
#pragma once
#include "team.h"

struct Cover {
    Team team;
    int height, width;           // Of the colour image.
    int cells;                   // Of the grid.
    const bool* keep;            // (cells), those that take part.
    const int *z, *low, *high;   // (cells) and (cells, 2): depth, first and last column and row.

    struct Box {
        int left, top, right, bottom;
    };

    Box box(int cell) const {
        const int left = low[2 * cell] - 1, top = low[2 * cell + 1] - 1;
        const int right = high[2 * cell] + 1, bottom = high[2 * cell + 1] + 1;
        return {left < 0 ? 0 : left, top < 0 ? 0 : top, right < width ? right : width - 1,
                bottom < height ? bottom : height - 1};
    }

    // Whether each pixel of `mask` (height, width) lies under a kept cell.
    void paint(bool* mask) const {
        for (int i = team.rank; i < height * width; i += team.size) mask[i] = false;
        team.sync();
        for (int cell = team.rank; cell < cells; cell += team.size) {
            if (!keep[cell]) continue;
            const Box at = box(cell);
            for (int v = at.top; v <= at.bottom; ++v)
                for (int u = at.left; u <= at.right; ++u) mask[v * width + u] = true;
        }
    }
};

struct CoveredCorners {
    Cover cover;
    int count, slots;         // Corners, and what there is room for.
    const int *u, *v;         // (slots)
    int* words;               // Scratch: rows * row_words() bits, then a list for each row.
    int* cell_out;            // (slots), the nearest cell over each, of equal ones the first; -1.

    enum { CELL_BITS = 18 };

    int row_words() const { return (cover.width + 31) / 32; }

    void run() const {
        const Team& team = cover.team;
        const int rows = cover.height, across = row_words();
        // Keys depth << CELL_BITS | cell come first, for they have 64 bits.
        unsigned long long* nearest = (unsigned long long*)words;
        int* bits = words + 2 * slots;
        int* first = bits + rows * across;
        int* next = first + rows;
        const unsigned long long nothing = ~0ull;
        for (int i = team.rank; i < rows * across; i += team.size) bits[i] = 0;
        for (int i = team.rank; i < rows; i += team.size) first[i] = -1;
        for (int i = team.rank; i < slots; i += team.size) nearest[i] = nothing;
        team.sync();
        for (int i = team.rank; i < count; i += team.size) {
            team.set(&bits[v[i] * across + u[i] / 32], 1 << (u[i] & 31));
            next[i] = team.swap(&first[v[i]], i);
        }
        team.sync();
        for (int cell = team.rank; cell < cover.cells; cell += team.size) {
            if (!cover.keep[cell]) continue;
            const Cover::Box at = cover.box(cell);
            const unsigned long long key =
                (unsigned long long)cover.z[cell] << CELL_BITS | (unsigned)cell;
            for (int row = at.top; row <= at.bottom; ++row) {
                bool hit = false;
                for (int w = at.left / 32; w <= at.right / 32; ++w)
                    hit |= bits[row * across + w] != 0;
                if (!hit) continue;
                for (int i = first[row]; i >= 0; i = next[i])
                    if (at.left <= u[i] && u[i] <= at.right) team.least(&nearest[i], key);
            }
        }
        team.sync();
        for (int i = team.rank; i < slots; i += team.size)
            cell_out[i] = nearest[i] == nothing
                              ? -1
                              : (int)(nearest[i] & ((1ull << CELL_BITS) - 1));
    }
};
