// The visible edge of each label on the floor: in each column of cells, its nearest cell.
// Twin of `contours` in jaxdet/reference/_outlines.py for grids of at most MAX_CONTOUR columns.
#pragma once
#include "team.h"

struct Contours {
    typedef unsigned long long Key;
    enum { ROW_BITS = 9 };
    int count, rows, columns;
    const int *right, *forward;            // of each cell
    const int *column_low, *column_high;   // of each label
    // Of each label and column, the smallest squared distance, then the uppermost row; all ones
    // where there is none. Only a label's own columns are kept.
    Key* nearest;
    // Points of label `l` are `start[l]` to `start[l + 1]`, from left to right.
    int *start, *x, *y, *column;

    Key& at(int l, int c) const { return nearest[(size_t)l * columns + c]; }

    void clear(const Team& team) const {
        for (int l = 0; l < count; ++l) {
            const int last = column_high[l];
            for (int c = column_low[l] + team.rank; c <= last; c += team.size) at(l, c) = ~0ull;
        }
        team.sync();
    }

    // From the cells of a frame. Ends in a sync.
    void find(const Team& team, const int* label) const {
        clear(team);
        for (int row = 0; row < rows; ++row) {
            for (int c = team.rank; c < columns; c += team.size) {
                const int i = row * columns + c, l = label[i];
                if (l < 0) continue;
                const long long r = right[i], f = forward[i];
                team.least(&at(l, c), (Key)(r * r + f * f) << ROW_BITS | row);
            }
        }
        team.sync();
    }

    // From those of parts: part `l` belongs to `whole[l]`. Ends in a sync.
    void join(const Team& team, const Contours& parts, const int* whole) const {
        clear(team);
        for (int l = 0; l < parts.count; ++l) {
            const int last = parts.column_high[l];
            for (int c = parts.column_low[l] + team.rank; c <= last; c += team.size) {
                team.least(&at(whole[l], c), parts.at(l, c));
            }
        }
        team.sync();
    }

    // The points. Ends in a sync.
    void list(const Team& team) const {
        for (int l = team.rank; l < count; l += team.size) {
            int points = 0;
            for (int c = column_low[l]; c <= column_high[l]; ++c) points += at(l, c) != ~0ull;
            start[l + 1] = points;
        }
        if (team.rank == 0) start[0] = 0;
        team.sync();
        if (team.rank == 0) {
            for (int l = 0; l < count; ++l) start[l + 1] += start[l];
        }
        team.sync();
        for (int l = team.rank; l < count; l += team.size) {
            int point = start[l];
            for (int c = column_low[l]; c <= column_high[l]; ++c) {
                if (at(l, c) == ~0ull) continue;
                const int i = (int)(at(l, c) & ((1 << ROW_BITS) - 1)) * columns + c;
                x[point] = right[i];
                y[point] = forward[i];
                column[point++] = c;
            }
        }
        team.sync();
    }
};
