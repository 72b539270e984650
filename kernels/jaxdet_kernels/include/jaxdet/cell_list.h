// Compacted list of the labelled cells of a frame, usually a small fraction of all cells.
#pragma once
#include "arena.h"
#include "warp.h"

namespace jaxdet { namespace {

struct CellList {
    int* count;
    // Index, label and position on the floor of each listed cell, in raster order.
    int *cell, *label, *right, *forward;
    BitRows has;  // bitmap of the listed cells
    int* before;  // scratch: number of listed cells before each word of the bitmap

    void allocate(Arena& arena, int rows, int columns) {
        take(arena, 1, count);
        take(arena, rows * columns, cell, label, right, forward);
        has = BitRows(rows, columns, nullptr);
        take(arena, has.count(), has.bits);
        take(arena, has.count() + 1, before);
    }

    // Lists the cells of the bitmap, which must have been set. Ends in a sync.
    void list(
        const Team& team, const int* labels, const int* at_right, const int* at_forward
    ) const {
        const int all = count_before(team, has, before);
        const Warp warp(team);
        if (team.rank == 0) *count = all;
        for (int i = warp.index; i < has.count(); i += warp.count) {
            const unsigned word = has[i];
            warp.each_bit(word, [&](int k) {
                const int n = before[i] + BitRows::popcount(word & ((1u << k) - 1));
                const int from = has.cell(i, k);
                cell[n] = from;
                label[n] = labels[from];
                right[n] = at_right[from];
                forward[n] = at_forward[from];
            });
        }
        team.sync();
    }
};

} }  // namespace jaxdet
