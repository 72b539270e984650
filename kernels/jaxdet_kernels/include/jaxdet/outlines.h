// Outline of each obstacle on the floor: its contour, and the rectangle that fits it. Twin of
// jaxdet/reference/_outlines.py.
#pragma once
#include "arena.h"
#include "measures.h"
#include "obstacle_cells.h"
#include "ranks.h"

namespace jaxdet { namespace {

struct Outlines {
    // Indices of settings. TRIM: maximum number of outermost cells that are trimmed for A, B and C. VERTEX:
    // minimum distance by which a vertex is nearer than A and B. LONG: length from which the long sides
    // of a rectangle are trimmed. Lengths are in depth units.
    enum { TRIM, VERTEX, LONG, SETTINGS };
    enum {
        DIRECTIONS = 90,
        DIRECTION_BITS = 9,
        LONG_TRIM = 20,
        // Number of bits of a cell index.
        CELL_BITS = 20,
        // Cost if no edge faces the camera; it is larger than any sum of distances to edges.
        NO_EDGE = 1 << 30
    };

    const ObstacleCells& cells;
    const Warp& warp;
    const Measures& measures;
    int slots, longest;
    const int* directions;  // (DIRECTIONS, 2): candidate directions, right and forward
    // Results, one row per slot; a contour has room for one point per column. `results` has all of them
    // and those of `measures`, except for the contours.
    int *contour_out, *points_out, *direction_out, *span_out, *results;
    int result_words;
    // Key of the nearest cell of each obstacle in each column: its squared distance, then its index.
    unsigned long long* nearest;
    // Area and cost of the rectangle of each obstacle in each direction, see `fits_better`.
    long long* area;
    int* cost;
    // Number of contour points in the left and in the right margin, per obstacle.
    int* margins;
    // Coordinate of each cell along or across the direction, in the order of the sorted cells.
    int* projected;

    // Allocates the arrays, then those of `grid`, which must be the object that `cells` refers to.
    void allocate(Arena& arena, ObstacleCells& grid) {
        arena.take(2 * slots * cells.columns, nearest);
        arena.take(2 * slots * DIRECTIONS, area);
        arena.take(slots * DIRECTIONS, cost);
        arena.take(2 * slots, margins);
        arena.take(cells.cells, projected);
        grid.allocate(arena, slots);
    }

    // Computes contours, rectangles and `measures`. Ends in a sync.
    void run() const {
        const Team& team = cells.team;
        clear();
        cells.clear();
        team.sync();
        cells.listed.take(team, cells.cells, cells.label, cells.count, cells.right, cells.forward);
        count();
        team.sync();
        if (warp.index == 0) cells.order(warp);
        for (int number = warp.index; number < cells.count; number += warp.count)
            put_contour(number);
        team.sync();
        cells.sort();
        compare_directions();
        team.sync();
        // The rectangle of an obstacle and each of its measurements are separate units of work.
        enum { PIECES = Measures::KINDS + 1 };
        for (int piece = warp.index; piece < PIECES * cells.count; piece += warp.count) {
            const int number = piece / PIECES, kind = piece % PIECES;
            if (kind == Measures::KINDS)
                put_rectangle(number);
            else
                measures.measure(number, kind);
        }
        team.sync();
        measures.find_vertices();
        team.sync();
    }

    void clear() const {
        const Team& team = cells.team;
        const int used = cells.count * cells.columns, points = slots * cells.columns;
        unsigned long long* const pairs = (unsigned long long*)contour_out;
        for (int i = team.rank; i < used; i += team.size) nearest[i] = ~0ull;
        for (int i = team.rank; i < points; i += team.size) pairs[i] = 0;
        for (int i = team.rank; i < result_words; i += team.size) results[i] = 0;
    }

    // Counts the cells of the parts of each obstacle, and finds its nearest cell in each column.
    void count() const {
        const Team& team = cells.team;
        const CellList& listed = cells.listed;
        for (int i = team.rank; i < *listed.count; i += team.size) {
            const int k = listed.cell[i], column = k % cells.columns, number = listed.label[i];
            const int place = cells.place(number, column);
            listed.label[i] = place;
            team.atomic_count(cells.filled + place);
            team.atomic_min(nearest + number * cells.columns + column,
                       key(k, listed.right[i], listed.forward[i]));
        }
    }

    // Key by which the cells of a column are compared: squared distance, then cell index.
    unsigned long long key(int k, long long x, long long y) const {
        return (unsigned long long)(x * x + y * y) << CELL_BITS | (unsigned)k;
    }

    // Writes the contour of an obstacle, from left to right, and counts its points in either margin.
    void put_contour(int number) const {
        const unsigned long long* own = nearest + number * cells.columns;
        int* out = contour_out + 2 * number * cells.columns;
        int points = 0, sides[2] = {0, 0}, found;
        for (int first = 0; first < cells.columns; first += warp.size, points += found) {
            const int c = first + warp.lane;
            const unsigned long long key = c < cells.columns ? own[c] : ~0ull;
            const int at = points + warp.ballot_rank(key != ~0ull, &found);
            if (key == ~0ull) continue;
            const int k = (int)(key & ((1 << CELL_BITS) - 1));
            out[2 * at] = cells.right[k];
            out[2 * at + 1] = cells.forward[k];
            if (cells.margins.has(c)) ++sides[2 * c >= cells.columns];
        }
        for (int side = 0; side < 2; ++side) sides[side] = warp.sum(sides[side]);
        if (warp.lane) return;
        points_out[number] = points;
        for (int side = 0; side < 2; ++side) margins[2 * number + side] = sides[side];
    }

    // Computes how well each direction fits each contour, without points in the margins unless more
    // than half of the points are there.
    void compare_directions() const {
        const Team& team = cells.team;
        for (int i = team.rank; i < cells.count * DIRECTIONS; i += team.size) {
            const int number = i / DIRECTIONS, points = points_out[number];
            const int left = margins[2 * number], right = margins[2 * number + 1];
            const bool every = 2 * (left + right) > points;
            const int* line = contour_out + 2 * (number * cells.columns + (every ? 0 : left));
            compare(i, line, every ? points : points - left - right, directions + 2 * (i % DIRECTIONS));
        }
    }

    // Computes area and cost of the rectangle around `n` points. The cost is the sum of the distances from
    // the points to the nearer of the edges that face the camera.
    void compare(int i, const int* line, int n, const int* direction) const {
        const int dx = direction[0], dy = direction[1];
        Extremes along, across;
        for (int j = 0; j < n; ++j) {
            const int x = line[2 * j], y = line[2 * j + 1];
            along.add(dx * x + dy * y);
            across.add(dx * y - dy * x);
        }
        if (n == 0) along = across = {0, 0};
        const int low = along.low, high = along.high, first = across.low, last = across.high;
        const int wide = high - low, deep = last - first;
        area[i] = (long long)(wide >> DIRECTION_BITS) * (deep >> DIRECTION_BITS);
        // Distances are `turn * place + shift`; an edge that does not face the camera is farther away
        // than any cell.
        const int turn = low > 0 ? 1 : high < 0 ? -1 : 0, other = first > 0 ? 1 : last < 0 ? -1 : 0;
        const int shift = turn > 0 ? -low : turn ? high : (int)Extremes::MOST;
        const int away = other > 0 ? -first : other ? last : (int)Extremes::MOST;
        const int ax = turn * dx, ay = turn * dy, bx = -other * dy, by = other * dx;
        long long total = 0;
        for (int j = 0; j < n; ++j) {
            const int x = line[2 * j], y = line[2 * j + 1];
            const int to_side = ax * x + ay * y + shift, to_front = bx * x + by * y + away;
            total += to_side < to_front ? to_side : to_front;
        }
        cost[i] = turn || other ? (int)(total >> DIRECTION_BITS) : (int)NO_EDGE;
    }

    // Writes the best direction of an obstacle and the extremes of its cells along and across it.
    void put_rectangle(int number) const {
        const ObstacleCells::Range every = cells.all(number), relied = cells.relied(number);
        if (every.size() == 0) return;
        const int* direction = directions + 2 * best_direction(number);
        const int dx = direction[0], dy = direction[1];
        int span[4];
        extremes(every, dx, dy, span);
        extremes(every, -dy, dx, span + 2);
        const int along = (span[1] - span[0]) >> DIRECTION_BITS;
        const int across = (span[3] - span[2]) >> DIRECTION_BITS;
        const bool turned = across < along;
        const int ax = turned ? -dy : dx, ay = turned ? dx : dy;
        int* side = span + 2 * turned;
        extremes(relied, ax, ay, side);
        if ((turned ? along : across) > longest) trim(relied, ax, ay, side);
        if (warp.lane) return;
        for (int j = 0; j < 2; ++j) direction_out[2 * number + j] = direction[j];
        for (int j = 0; j < 4; ++j) span_out[4 * number + j] = span[j];
    }

    int best_direction(int number) const {
        const int first = number * DIRECTIONS;
        int best = first + warp.lane;
        for (int i = best + warp.size; i < first + DIRECTIONS; i += warp.size)
            if (fits_better(i, best)) best = i;
#if defined(__CUDA_ARCH__)
        for (int away = Warp::size / 2; away; away /= 2) {
            const int other = __shfl_xor_sync(0xffffffff, best, away);
            if (fits_better(other, best)) best = other;
        }
#endif
        return best - first;
    }

    // Whether direction `one` fits better than `other`; if both fit equally well, the first is better.
    bool fits_better(int one, int other) const {
        if (cost[one] != cost[other]) return cost[one] < cost[other];
        return area[one] != area[other] ? area[one] < area[other] : one < other;
    }

    void extremes(ObstacleCells::Range range, int ax, int ay, int* found) const {
        Extremes all;
        for (int i = range.first + warp.lane; i < range.end; i += warp.size)
            all.add(ax * cells.right_of[i] + ay * cells.forward_of[i]);
        measures.put(all, found, found + 1);
    }

    // Sets `side` to the extremes after one in LONG_TRIM cells is removed at each end.
    void trim(ObstacleCells::Range range, int ax, int ay, int* side) const {
        const Ranks ranks(warp);
        const int passed = range.size() / LONG_TRIM, first = range.first, end = range.end;
        for (int i = first + warp.lane; i < end; i += warp.size)
            projected[i] = ax * cells.right_of[i] + ay * cells.forward_of[i];
        const int low = side[0], high = side[1];
        side[0] = ranks.at(projected, 0, first, end, passed, low, high);
        side[1] = ~ranks.at(projected, -1, first, end, passed, ~high, ~low);
    }
};

} }  // namespace jaxdet
