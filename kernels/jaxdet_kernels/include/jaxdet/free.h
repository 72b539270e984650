// Visible free floor in each column of cells, and the reason of its end. Twin of
// jaxdet/reference/_free.py.
#pragma once
#include "floor_frame.h"
#include "warp.h"

namespace jaxdet { namespace {

struct FreeFloor {
    // Indices of settings; lengths are in depth units. FAR: end of the range. GAP: longest gap without
    // measurements within free floor. NEAREST, IN_RANGE and HIGHEST: minimum depth, maximum depth and
    // maximum height of obstacles on rays. HALF_TURN: half the angle of a cell. NOTCH: minimum depth of
    // a notch. MIN_CELLS: minimum number of cells of an obstacle in a notch.
    enum { FAR, GAP, NEAREST, IN_RANGE, HIGHEST, HALF_TURN, NOTCH, MIN_CELLS, SETTINGS };
    enum { UNKNOWN, OBSTACLE, DROP, RANGE };
    enum {
        // Number of consecutive measured cells, lower than the floor by a drop, at which the floor ends.
        RUN = 3,
        // Number of neighbouring columns on each side of a drop; more than half of them must drop too.
        NEIGHBOURS = 14,
        // The cells beyond a drop must not be behind floor that is farther up in the image: the distance
        // of such floor must be at least 1 - 1 / SHARE of the distance of the nearest of these cells.
        SHARE = 5,
        LARGEST = 0x7fffffff,
        DEPTHS = 65536,
        // On CUDA a thread follows one column. It loads several cells at a time: SEEK in the search of
        // the nearest obstacle, AHEAD along the floor, and BEHIND beyond the end of the floor. On the
        // CPU, ABREAST columns are followed together, in loops that are vectorized.
        SEEK = Warp::size > 1 ? 8 : 1,
        AHEAD = Warp::size > 1 ? 4 : 1,
        BEHIND = Warp::size > 1 ? 4 : 1,
        ABREAST = Warp::size > 1 ? 1 : 256
    };

    // State of columns that are followed together.
    struct Columns {
        // Distance [depth units] and row of the nearest obstacle; if there is none, the end of the
        // range and -1.
        int limit[ABREAST], nearest[ABREAST];
        // Rows of the first and of the last floor cell so far, -1 if there is none yet; forward
        // distance and height of the last one [depth units].
        int first[ABREAST], last[ABREAST], forward[ABREAST], height[ABREAST];
        // Whether the floor has ended; whether it drops after its last cell, -1 if that is not tested
        // yet.
        int ended[ABREAST], falls[ABREAST];
    };

    const Team& team;
    int rows, columns, near, far, gap;
    const int *label, *z, *right, *forward, *height;
    const bool* low;
    const int *bows, *drops;  // (DEPTHS,) tolerance of bowing, and minimum height of a drop, by z
    int *line_out, *end_out;
    int* falls;  // scratch, (columns): whether the floor of each column drops
    bool turned;  // whether the camera is upside down, so that rows and columns are reversed

    int at(int row, int column) const {
        const int k = row * columns + column;
        return turned ? rows * columns - 1 - k : k;
    }

    // Copies n cells of a row from column `left` on to `out`; `turned` is taken into account as in
    // `at`.
    template <class Cell>
    void take(const Cell* from, int row, int left, int n, int* __restrict__ out) const {
        const Cell* const cell = from + at(row, left);
        if (turned)
            for (int c = 0; c < n; ++c) out[c] = cell[-c];
        else
            for (int c = 0; c < n; ++c) out[c] = cell[c];
    }

    // Finds the free floor for an upright or inverted camera; it is unknown if the camera is on its side.
    void run(const FloorFrame& frame) {
        turned = frame.is_upside_down();
        if (frame.is_on_side()) {
            for (int k = team.rank; k < 4 * columns; k += team.size) line_out[k] = 0;
            for (int c = team.rank; c < columns; c += team.size) end_out[c] = UNKNOWN;
            team.sync();
            return;
        }
        for (int left = team.rank * ABREAST; left < columns; left += team.size * ABREAST) {
            const bool fits = ABREAST == 1 || columns - left >= ABREAST;
            const int n = fits ? (int)ABREAST : columns - left;
            Columns of;
            find_obstacles(of, left, n);
            int open = n;
            for (int bottom = rows - 1; bottom >= 0 && open; bottom -= AHEAD) {
                follow(of, bottom, left, n);
                open = 0;
                for (int c = 0; c < n; ++c) open += !of.ended[c];
            }
            for (int c = 0; c < n; ++c) put(of, c, left + c);
        }
        team.sync();
        for (int c = team.rank; c < columns; c += team.size) {
            int dropping = 0;
            for (int other = c - NEIGHBOURS; other <= c + NEIGHBOURS; ++other)
                dropping += other >= 0 && other < columns ? falls[other] : 0;
            if (falls[c] && dropping <= NEIGHBOURS) end_out[c] = UNKNOWN;
        }
        team.sync();
    }

    // Finds the nearest obstacle cell of each column, the uppermost of equally near ones, and
    // initializes the floor.
    void find_obstacles(Columns& __restrict__ of, int left, int n) const {
        for (int c = 0; c < n; ++c) {
            of.limit[c] = LARGEST;
            of.nearest[c] = of.first[c] = of.last[c] = of.falls[c] = -1;
            of.forward[c] = of.height[c] = of.ended[c] = 0;
        }
        for (int top = 0; top < rows; top += SEEK) {
            int own[SEEK][ABREAST], ahead[SEEK][ABREAST];
            for (int i = 0; i < SEEK; ++i) {
                const int row = top + i < rows ? top + i : rows - 1;  // repeats without effect
                take(label, row, left, n, own[i]);
                take(forward, row, left, n, ahead[i]);
            }
            for (int i = 0; i < SEEK; ++i)
                for (int c = 0; c < n; ++c) {
                    const bool nearer = (own[i][c] >= 0) & (ahead[i][c] < of.limit[c]);
                    of.limit[c] = nearer ? ahead[i][c] : of.limit[c];
                    of.nearest[c] = nearer ? top + i : of.nearest[c];
                }
        }
        for (int c = 0; c < n; ++c) of.limit[c] = of.nearest[c] >= 0 ? of.limit[c] : far;
    }

    // Follows the floor through AHEAD cells of each column, from row `bottom` upwards.
    void follow(Columns& __restrict__ of, int bottom, int left, int n) const {
        int on[AHEAD][ABREAST], ahead[AHEAD][ABREAST], high[AHEAD][ABREAST], depth[AHEAD][ABREAST];
        int bow[AHEAD][ABREAST], drop[AHEAD][ABREAST], jumps[ABREAST], some = 0;
        for (int i = 0; i < AHEAD; ++i) {
            const int row = bottom > i ? bottom - i : 0;
            take(forward, row, left, n, ahead[i]);
            take(height, row, left, n, high[i]);
            take(z, row, left, n, depth[i]);
            take(low, row, left, n, on[i]);
            for (int c = 0; c < n; ++c) {
                on[i][c] &= (bottom >= i) & !of.ended[c] & (ahead[i][c] < of.limit[c]) &
                            (depth[i][c] >= near) & (depth[i][c] <= far);
                some |= on[i][c];
            }
        }
        if (!some) return;
        for (int i = 0; i < AHEAD; ++i)
            for (int c = 0; c < n; ++c) {
                bow[i][c] = bows[depth[i][c]];
                drop[i][c] = drops[depth[i][c]];
            }
        for (int i = 0; i < AHEAD; ++i) {
            int any = 0;
            for (int c = 0; c < n; ++c) {
                const int floor = on[i][c] & !of.ended[c] & (high[i][c] >= -bow[i][c]);
                const int goes_on = floor & (of.first[c] >= 0);
                const int is_gap = goes_on & (ahead[i][c] - of.forward[c] > gap);
                const int jump = goes_on & ~is_gap & (of.height[c] - high[i][c] > drop[i][c]);
                const int next = floor & ~is_gap & ~jump;
                of.ended[c] |= is_gap;
                of.first[c] = floor & ~goes_on ? bottom - i : of.first[c];
                of.last[c] = next ? bottom - i : of.last[c];
                of.forward[c] = next ? ahead[i][c] : of.forward[c];
                of.height[c] = next ? high[i][c] : of.height[c];
                of.falls[c] = next ? -1 : of.falls[c];
                jumps[c] = jump;
                any |= jump;
            }
            for (int c = 0; any && c < n; ++c)
                if (jumps[c]) of.ended[c] = falls_after(of, c, left + c);
        }
    }

    // Whether the next RUN measured cells up column c are lower than its last floor cell by a drop and
    // lie flat, and no floor farther up is clearly nearer than they are. `i` is the index of the column
    // in `of`. The result is stored in `of.falls`.
    int falls_after(Columns& of, int i, int c) const {
        if (of.falls[i] < 0) of.falls[i] = look_behind(of.last[i], of.height[i], c);
        return of.falls[i];
    }

    int look_behind(int last, int floor, int c) const {
        int found = 0, before_height = 0, before_forward = 0, nearest = LARGEST;
        for (int first = last - 1; first >= 0; first -= BEHIND) {
            int own[BEHIND];
            bool on[BEHIND];
            for (int n = 0; n < BEHIND; ++n) {
                const int k = at(first > n ? first - n : 0, c);
                own[n] = first >= n ? label[k] : -1;
                on[n] = first >= n && low[k];
            }
            for (int n = 0; n < BEHIND; ++n) {
                if (own[n] >= 0 && found < RUN) return 0;
                if (!on[n]) continue;
                const int k = at(first - n, c);
                const bool level = floor - height[k] <= drops[z[k]];
                if (found == RUN) {
                    if (level && SHARE * forward[k] < (SHARE - 1) * nearest) return 0;
                    continue;
                }
                const int rise = height[k] - before_height, run = forward[k] - before_forward;
                const bool upright = (rise < 0 ? -rise : rise) >= (run < 0 ? -run : run);
                if (level || (found > 0 && upright)) return 0;
                ++found;
                before_height = height[k];
                before_forward = forward[k];
                nearest = forward[k] < nearest ? forward[k] : nearest;
            }
        }
        return found == RUN;
    }

    // Writes the points at which the free floor of column c begins and ends, and why it ends; `i` is the
    // index of the column in `of`. `run` removes drops in too few columns later.
    void put(Columns& of, int i, int c) const {
        const int obstacle = of.nearest[i];
        const bool blocked = obstacle >= 0, seen = of.first[i] >= 0;
        const bool falls_off = seen && falls_after(of, i, c);
        const bool close = seen && of.limit[i] - of.forward[i] <= gap;
        const bool up_to = blocked && (!seen || (close && !falls_off));
        put_place(0, seen ? of.first[i] : obstacle, c);
        put_place(1, up_to ? obstacle : of.last[i], c);
        falls[c] = falls_off;
        end_out[c] = falls_off ? DROP : up_to ? OBSTACLE : close ? RANGE : UNKNOWN;
    }

    // Writes the position of a cell on the floor as the first (0) or the last (1) end of the line of
    // column c; zeros if `row` is -1.
    void put_place(int end, int row, int c) const {
        int* place = line_out + 4 * c + 2 * end;
        place[0] = row < 0 ? 0 : right[at(row, c)];
        place[1] = row < 0 ? 0 : forward[at(row, c)];
    }
};

} }  // namespace jaxdet
