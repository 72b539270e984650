// How far the floor is seen in each column of cells, and what ends it. Twin of
// jaxdet/reference/_free.py.
#pragma once
#include "team.h"

struct FreeFloor {
    enum { FAR, GAP, SETTINGS };
    enum { UNKNOWN, OBSTACLE, DROP, RANGE };
    enum {
        // So many measured cells one after the other are a drop lower than the last floor.
        RUN = 3,
        // Columns on both sides of one that drops, more than half of which must drop too.
        BESIDE = 10,
        LARGEST = 0x7fffffff,
        DEPTHS = 65536,
        // On CUDA the loads of so many cells wait together: up to the nearest obstacle, on the way
        // up the floor, and behind its end.
        SEEK = 8,
        AHEAD = 4,
#if defined(__CUDA_ARCH__)
        BEHIND = 4
#else
        BEHIND = 1
#endif
    };

    // What is known of a column while one goes up its cells.
    struct Column {
        // The nearest obstacle's distance and row, or the range and -1.
        int limit, nearest;
        // Rows where the floor begins and where it has come to, -1 = none yet.
        int first, last;
        // Of the last cell of the floor.
        int forward, height;
        // Whether the floor has ended, and whether it drops there, -1 = not looked at yet.
        int ended, falls;
    };
    enum { COLUMN_WORDS = 8 };

    const Team& team;
    int rows, columns, far, gap;
    const int *label, *z, *right, *forward, *height;
    const bool* low;
    const int *bows, *drops;  // (DEPTHS,), by z
    int *line_out, *end_out;
    // By column: the nearest obstacle's distance and row, and whether the floor drops.
    int *limit, *nearest, *falls;
    Column* state;

    explicit FreeFloor(const Team& team) : team(team) {}

    // Puts the arrays into scratch memory, 3 + COLUMN_WORDS words by column.
    void lay(int* scratch) {
        limit = scratch;
        nearest = limit + columns;
        falls = nearest + columns;
        state = (Column*)(falls + columns);
    }

    void run() const {
#if defined(__CUDA_ARCH__)
        // A column a thread.
        for (int c = team.rank; c < columns; c += team.size) {
            Column column = nearest_of(c);
            for (int bottom = rows - 1; bottom >= 0 && !column.ended; bottom -= AHEAD) {
                int ahead[AHEAD], high[AHEAD], depth[AHEAD], bow[AHEAD], drop[AHEAD];
                bool on[AHEAD];
                for (int n = 0; n < AHEAD; ++n) {
                    const int k = (bottom > n ? bottom - n : 0) * columns + c;
                    on[n] = bottom >= n && low[k];
                    ahead[n] = forward[k], high[n] = height[k], depth[n] = z[k];
                }
                for (int n = 0; n < AHEAD; ++n) {
                    on[n] &= (ahead[n] < column.limit) & (depth[n] <= far);
                    bow[n] = on[n] ? bows[depth[n]] : 0;
                    drop[n] = on[n] ? drops[depth[n]] : 0;
                }
                for (int n = 0; n < AHEAD && !column.ended; ++n)
                    if (on[n] && high[n] >= -bow[n])
                        follow(column, bottom - n, c, ahead[n], high[n], drop[n]);
            }
            put(column, c);
        }
#else
        // Row by row, as the cells lie in memory.
        find_obstacles();
        for (int c = 0; c < columns; ++c) state[c] = start(limit[c], nearest[c]);
        for (int row = rows - 1; row >= 0; --row)
            for (int c = 0; c < columns; ++c) {
                const int k = row * columns + c;
                if (!low[k] || state[c].ended || forward[k] >= state[c].limit) continue;
                if (z[k] <= far && height[k] >= -bows[z[k]])
                    follow(state[c], row, c, forward[k], height[k], drops[z[k]]);
            }
        for (int c = 0; c < columns; ++c) put(state[c], c);
#endif
        team.sync();
        for (int c = team.rank; c < columns; c += team.size) {
            int beside = 0;
            for (int other = c - BESIDE; other <= c + BESIDE; ++other)
                beside += other >= 0 && other < columns ? falls[other] : 0;
            if (falls[c] && beside <= BESIDE) end_out[c] = UNKNOWN;
        }
        team.sync();
    }

    // A column before one goes up its cells; its nearest obstacle's distance, and row or -1.
    Column start(int distance, int row) const {
        return {row >= 0 ? distance : far, row, -1, -1, 0, 0, 0, -1};
    }

    // The nearest obstacle of each column, of equal ones the uppermost.
#if defined(__CUDA_ARCH__)
    Column nearest_of(int c) const {
        int distance = LARGEST, found = -1;
        for (int top = 0; top < rows; top += SEEK) {
            int own[SEEK], ahead[SEEK];
            for (int n = 0; n < SEEK; ++n) {
                const int row = top + n;
                own[n] = row < rows ? label[row * columns + c] : -1;
            }
            for (int n = 0; n < SEEK; ++n)
                ahead[n] = own[n] >= 0 ? forward[(top + n) * columns + c] : (int)LARGEST;
            for (int n = 0; n < SEEK; ++n) {
                if (ahead[n] >= distance) continue;
                distance = ahead[n];
                found = top + n;
            }
        }
        return start(distance, found);
    }
#else
    void find_obstacles() const {
        for (int c = 0; c < columns; ++c) {
            limit[c] = LARGEST;
            nearest[c] = -1;
        }
        const int wide = columns;
        int *__restrict limits = limit, *__restrict rows_of = nearest;
        for (int row = 0; row < rows; ++row) {
            const int *own = label + row * wide, *ahead = forward + row * wide;
            for (int c = 0; c < wide; ++c) {
                const bool nearer = (own[c] >= 0) & (ahead[c] < limits[c]);
                limits[c] = nearer ? ahead[c] : limits[c];
                rows_of[c] = nearer ? row : rows_of[c];
            }
        }
    }
#endif

    // Goes on with a cell that may be floor, from the bottom row up.
    void follow(Column& column, int row, int c, int ahead, int high, int drop) const {
        if (column.first < 0) {
            column.first = row;
        } else if (ahead - column.forward > gap) {
            column.ended = 1;
            return;
        } else if (column.height - high > drop) {
            if (column.falls < 0) column.falls = falls_after(column, c);
            column.ended = column.falls;
            return;
        }
        column.last = row;
        column.forward = ahead;
        column.height = high;
        column.falls = -1;
    }

    // Whether the next RUN measured cells up a column are a drop lower, and lie flat.
    int falls_after(const Column& column, int c) const {
        int found = 0, before_height = 0, before_forward = 0;
        for (int first = column.last - 1; first >= 0; first -= BEHIND) {
            int own[BEHIND];
            bool on[BEHIND];
            for (int n = 0; n < BEHIND; ++n) {
                const int k = (first > n ? first - n : 0) * columns + c;
                own[n] = first >= n ? label[k] : -1;
                on[n] = first >= n && low[k];
            }
            for (int n = 0; n < BEHIND; ++n) {
                if (own[n] >= 0) return 0;
                if (!on[n]) continue;
                const int k = (first - n) * columns + c;
                if (column.height - height[k] <= drops[z[k]]) return 0;
                const int rise = height[k] - before_height, run = forward[k] - before_forward;
                if (found > 0 && (rise < 0 ? -rise : rise) >= (run < 0 ? -run : run)) return 0;
                if (++found == RUN) return 1;
                before_height = height[k];
                before_forward = forward[k];
            }
        }
        return 0;
    }

    // Where the free floor of a column begins and ends, but for drops that are too narrow.
    void put(Column& column, int c) const {
        const int obstacle = column.nearest, last = column.last;
        const bool blocked = obstacle >= 0, seen = column.first >= 0;
        if (seen && column.falls < 0) column.falls = falls_after(column, c);
        const bool falls_off = column.falls > 0;
        const bool close = seen && column.limit - column.forward <= gap;
        const bool up_to = blocked && (!seen || (close && !falls_off));
        put_place(0, seen ? column.first : obstacle, c);
        put_place(1, up_to ? obstacle : last, c);
        falls[c] = falls_off;
        end_out[c] = falls_off ? DROP : up_to ? OBSTACLE : close ? RANGE : UNKNOWN;
    }

    void put_place(int end, int row, int c) const {
        int* place = line_out + 4 * c + 2 * end;
        place[0] = row < 0 ? 0 : right[row * columns + c];
        place[1] = row < 0 ? 0 : forward[row * columns + c];
    }
};
