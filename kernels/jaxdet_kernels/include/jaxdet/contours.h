// Contour of each label on the floor, its visible edge: the nearest cell in each column. Twin of
// `contours` in jaxdet/reference/_outlines.py.
#pragma once
#include "cell_list.h"
#include "warp.h"

namespace jaxdet { namespace {

struct Contours {
    typedef unsigned long long Key;
    enum { ROW_BITS = 9 };
    int count, rows, columns;
    const int *right, *forward;            // (cells) positions on the floor [depth units]
    const int *column_low, *column_high;   // (labels) first and last column of each label
    // Key of the nearest cell of each label in each column: its squared distance, then its row, so that
    // the uppermost of equally near cells has the smallest key. All bits are 1 if there is no cell. Only
    // the columns from `column_low` to `column_high` of a label are valid.
    Key* nearest;
    // The points of label `l` are `start[l]` to `start[l + 1]` - 1, from left to right.
    int *start, *x, *y, *column;

    Key& at(int l, int c) const { return nearest[(size_t)l * columns + c]; }

    void clear(const Team& team) const {
        const Warp warp(team);
        for (int l = warp.index; l < count; l += warp.count) {
            const int last = column_high[l];
            for (int c = column_low[l] + warp.lane; c <= last; c += warp.size) at(l, c) = ~0ull;
        }
        team.sync();
    }

    Key key(int row, long long r, long long f) const {
        return (Key)(r * r + f * f) << ROW_BITS | row;
    }

    // Computes `nearest` from the listed cells. Ends in a sync.
    void find(const Team& team, const CellList& listed) const {
        clear(team);
        const int all = *listed.count;
        for (int i = team.rank; i < all; i += team.size) {
            const int row = listed.cell[i] / columns, c = listed.cell[i] - row * columns;
            team.atomic_min(&at(listed.label[i], c), key(row, listed.right[i], listed.forward[i]));
        }
        team.sync();
    }

    // Computes `nearest` from that of parts: part `l` belongs to label `whole[l]`. Ends in a sync.
    void join(const Team& team, const Contours& parts, const int* whole) const {
        clear(team);
        const Warp warp(team);
        for (int l = warp.index; l < parts.count; l += warp.count) {
            const int last = parts.column_high[l];
            for (int c = parts.column_low[l] + warp.lane; c <= last; c += warp.size) {
                team.atomic_min(&at(whole[l], c), parts.at(l, c));
            }
        }
        team.sync();
    }

    // Lists the contour points of all labels, from `nearest`. Ends in a sync.
    void list(const Team& team) const {
        const Warp warp(team);
        for (int l = warp.index; l < count; l += warp.count) {
            const int last = column_high[l];
            int points = 0;
            for (int c = column_low[l] + warp.lane; c <= last; c += warp.size) {
                points += at(l, c) != ~0ull;
            }
            points = warp.sum(points);
            if (warp.lane == 0) start[l] = points;
        }
        team.sync();
        if (warp.index == 0) warp.exclusive_sum(start, count);
        team.sync();
        for (int l = warp.index; l < count; l += warp.count) {
            const int last = column_high[l];
            int point = start[l], found;
            for (int first = column_low[l]; first <= last; first += warp.size, point += found) {
                const int c = first + warp.lane;
                const Key own = c <= last ? at(l, c) : ~0ull;
                const int place = point + warp.ballot_rank(own != ~0ull, &found);
                if (own == ~0ull) continue;
                const int i = (int)(own & ((1 << ROW_BITS) - 1)) * columns + c;
                x[place] = right[i];
                y[place] = forward[i];
                column[place] = c;
            }
        }
        team.sync();
    }
};

} }  // namespace jaxdet
