// How far the floor is seen in each column of cells, and what ends it. Twin of
// jaxdet/reference/_free.py.
#pragma once
#include "warp.h"

struct FreeFloor {
    // End of the range; the floor ends where so much of it shows no measurement.
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
        BEHIND = Warp::size > 1 ? 4 : 1,
        // On the CPU so many columns are followed side by side.
        ABREAST = 256
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
    const Team& team;
    int rows, columns, far, gap;
    const int *label, *z, *right, *forward, *height;
    const bool* low;
    const int *bows, *drops;  // (DEPTHS,), by z
    int *line_out, *end_out;
    // By column: whether the floor drops; on the CPU what else `Column` has.
    int *falls, *limit, *nearest, *first, *last, *ahead, *high, *ended;

    // Puts the arrays into scratch memory, as `scratch_words` in free_floor.py says.
    void lay(int* scratch) {
        int** const arrays[] = {&falls, &limit, &nearest, &first, &last, &ahead, &high, &ended};
        for (int** array : arrays) {
            *array = scratch;
            scratch += columns;
        }
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
        for (int c = 0; c < columns; ++c) {
            limit[c] = nearest[c] >= 0 ? limit[c] : far;
            first[c] = last[c] = falls[c] = -1;
            ahead[c] = high[c] = ended[c] = 0;
        }
        for (int row = rows - 1; row >= 0; --row)
            for (int c = 0; c < columns; c += ABREAST)
                follow_columns(row, c, columns - c < ABREAST ? columns - c : (int)ABREAST);
        for (int c = 0; c < columns; ++c) {
            Column column = column_of(c);
            put(column, c);
        }
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

#if defined(__CUDA_ARCH__)
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

#else
    Column column_of(int c) const {
        return {limit[c], nearest[c], first[c], last[c], ahead[c], high[c], ended[c], falls[c]};
    }

    // The same for a cell of each of n columns: in loops that become vectors, but for drops.
    void follow_columns(int row, int column, int n) const {
        const int k = row * columns + column, *depth = z + k;
        int on[ABREAST], bow[ABREAST], drop[ABREAST], jumps[ABREAST];
        if (!find_low(low + k, depth, forward + k, limit + column, ended + column, far, on, n)) return;
        for (int c = 0; c < n; ++c) {
            bow[c] = bows[depth[c]];
            drop[c] = drops[depth[c]];
        }
        if (!follow_low(row, gap, on, bow, drop, forward + k, height + k, first + column,
                        last + column, ahead + column, high + column, ended + column,
                        falls + column, jumps, n))
            return;
        for (int c = column; c < column + n; ++c) {
            if (!jumps[c - column]) continue;
            if (falls[c] < 0) falls[c] = falls_after(column_of(c), c);
            ended[c] = falls[c];
        }
    }

    // Which cells are low and before the nearest obstacle; whether any is.
    static bool find_low(
        const bool* __restrict low, const int* __restrict depth, const int* __restrict forward,
        const int* __restrict limit, const int* __restrict ended, int far, int* __restrict on, int n
    ) {
        int some = 0;
        for (int c = 0; c < n; ++c) some |= low[c];
        if (!some) return false;
        some = 0;
        for (int c = 0; c < n; ++c) {
            on[c] = low[c] & (ended[c] == 0) & (forward[c] < limit[c]) & (depth[c] <= far);
            some |= on[c];
        }
        return some;
    }

    // Goes on with them; which are a drop lower than the last, and whether any is.
    static bool follow_low(
        int row, int gap, const int* __restrict on, const int* __restrict bow,
        const int* __restrict drop, const int* __restrict forward, const int* __restrict height,
        int* __restrict first, int* __restrict last, int* __restrict ahead, int* __restrict high,
        int* __restrict ended, int* __restrict falls, int* __restrict jumps, int n
    ) {
        int some = 0;
        for (int c = 0; c < n; ++c) {
            const int floor = on[c] & (height[c] >= -bow[c]), goes_on = floor & (first[c] >= 0);
            const int is_gap = goes_on & (forward[c] - ahead[c] > gap);
            const int jump = goes_on & ~is_gap & (high[c] - height[c] > drop[c]);
            const int next = floor & ~is_gap & ~jump;
            ended[c] |= is_gap;
            first[c] = floor & ~goes_on ? row : first[c];
            last[c] = next ? row : last[c];
            ahead[c] = next ? forward[c] : ahead[c];
            high[c] = next ? height[c] : high[c];
            falls[c] = next ? -1 : falls[c];
            jumps[c] = jump;
            some |= jump;
        }
        return some;
    }
#endif

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
