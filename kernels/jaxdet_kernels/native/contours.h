// The visible edge of each label on the floor: in each column of cells, its nearest cell.
// Twin of `contours` in jaxdet/reference/_outlines.py for grids of at most MAX_CONTOUR columns.
#pragma once
#include "lanes.h"

struct Contours {
    typedef unsigned long long Key;
    enum { ROW_BITS = 9, AHEAD = 4 };
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
        const Lanes lanes(team);
        for (int l = lanes.index; l < count; l += lanes.count) {
            const int last = column_high[l];
            for (int c = column_low[l] + lanes.rank; c <= last; c += lanes.size) at(l, c) = ~0ull;
        }
        team.sync();
    }

    Key key(int row, long long r, long long f) const {
        return (Key)(r * r + f * f) << ROW_BITS | row;
    }

    // From the cells of a frame. Ends in a sync.
    void find(const Team& team, const int* label) const {
        clear(team);
#if defined(__CUDA_ARCH__)
        // Down the columns, AHEAD cells at a time: their loads wait together.
        for (int c = team.rank; c < columns; c += team.size) {
            int known = -1;
            Key best = ~0ull;
            for (int row = 0; row < rows; row += AHEAD) {
                int l[AHEAD], r[AHEAD], f[AHEAD];
                for (int k = 0; k < AHEAD; ++k) {
                    const bool inside = row + k < rows;
                    const int i = inside ? (row + k) * columns + c : c;
                    l[k] = inside ? label[i] : -1;
                    r[k] = right[i];
                    f[k] = forward[i];
                }
                for (int k = 0; k < AHEAD; ++k) {
                    if (l[k] != known) {
                        if (known >= 0) team.least(&at(known, c), best);
                        known = l[k];
                        best = ~0ull;
                    }
                    const Key own = key(row + k, r[k], f[k]);
                    best = own < best ? own : best;
                }
            }
            if (known >= 0) team.least(&at(known, c), best);
        }
#else
        for (int row = 0; row < rows; ++row) {
            for (int c = 0; c < columns; ++c) {
                const int i = row * columns + c, l = label[i];
                if (l >= 0) team.least(&at(l, c), key(row, right[i], forward[i]));
            }
        }
#endif
        team.sync();
    }

    // From those of parts: part `l` belongs to `whole[l]`. Ends in a sync.
    void join(const Team& team, const Contours& parts, const int* whole) const {
        clear(team);
        const Lanes lanes(team);
        for (int l = lanes.index; l < parts.count; l += lanes.count) {
            const int last = parts.column_high[l];
            for (int c = parts.column_low[l] + lanes.rank; c <= last; c += lanes.size) {
                team.least(&at(whole[l], c), parts.at(l, c));
            }
        }
        team.sync();
    }

    // The points. Ends in a sync.
    void list(const Team& team) const {
        const Lanes lanes(team);
        for (int l = lanes.index; l < count; l += lanes.count) {
            const int last = column_high[l];
            int points = 0;
            for (int c = column_low[l] + lanes.rank; c <= last; c += lanes.size) {
                points += at(l, c) != ~0ull;
            }
            points = lanes.sum(points);
            if (lanes.rank == 0) start[l + 1] = points;
        }
        team.sync();
        if (team.rank == 0) {
            int points = start[0] = 0;
            for (int l = 1; l <= count; ++l) start[l] = points += start[l];
        }
        team.sync();
        for (int l = lanes.index; l < count; l += lanes.count) {
            const int last = column_high[l];
            int point = start[l], found;
            for (int first = column_low[l]; first <= last; first += lanes.size, point += found) {
                const int c = first + lanes.rank;
                const Key own = c <= last ? at(l, c) : ~0ull;
                const int place = point + lanes.before(own != ~0ull, &found);
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
