// Creases: concave edges, where depth goes on but bends, for two things touch there.
// Twin of `creases` in jaxdet/reference/_surfaces.py.
#pragma once
#include "grid.h"
#include "runs.h"
#include "team.h"

struct Creases {
    enum {
        BITS = 4,           // fraction bits of smoothed depths
        NONE = -(1 << 26),  // in place of one where nothing is measured: far from all of them
        MOST_STEP = 1 << 16,
        MOST_LIMIT = 1 << 17,  // larger steps and limits mean the same
    };
    Grid grid;
    // How many cells away the bend is measured, least cells of a crease, cells it is made wider.
    int reach, least, margin;
    // By depth: the limit of bends.
    const int* limits;
    // (R, C): depth, 0 = none; 1 = kept.
    const int* z;
    const unsigned char* keep;
    // (grid): the surface steps; depths with BITS fraction bits and margins of NONE, destroyed.
    const int* steps;
    int* smooth;
    // (grid), and with margins of NONE.
    int* other;
    // (grid), margins of 0: what is found. And the same as scratch memory.
    unsigned char* found;
    unsigned char* wide;
    Runs runs;

    static int apart(int a, int b) { return a < b ? b - a : a - b; }

    // The rounded mean of the 3 x 3 neighbours that are at most two steps away. At most nine depths
    // below 2^20 are added up, so floats have them exactly, and their quotient, below 2^20 and a
    // ninth away from the next integer or more, is rounded by less than that.
    static void smooth_row(
        const int* __restrict__ up, const int* __restrict__ here, const int* __restrict__ down,
        const int* __restrict__ step, int* __restrict__ out, int lane, int n
    ) {
        for (int c = lane; c < n; c += Rows::LANES) {
            const int own = here[c], near = step[c] << (BITS + 1);
            int total = own, count = 1;
            const auto add = [&](int there) {
                const bool close = apart(there, own) <= near;
                total += close ? there : 0;
                count += close ? 1 : 0;
            };
            add(up[c - 1]);
            add(up[c]);
            add(up[c + 1]);
            add(here[c - 1]);
            add(here[c + 1]);
            add(down[c - 1]);
            add(down[c]);
            add(down[c + 1]);
            const int mean = (int)((float)(total + (count >> 1)) / (float)count);
            out[c] = own < 0 ? NONE : mean;
        }
    }

    void smoothed(const Rows& rows, const int* from, int* to) const {
        for (int r = rows.first; r < grid.rows; r += rows.step) {
            const int at = grid.row(r);
            smooth_row(
                from + at - grid.stride, from + at, from + at + grid.stride, steps + at, to + at,
                rows.lane, grid.columns
            );
        }
    }

    static void limits_of_row(
        const int* __restrict__ limits, const int* __restrict__ z, int* __restrict__ out, int lane,
        int n
    ) {
        for (int c = lane; c < n; c += Rows::LANES) {
            const int limit = limits[z[c]];
            out[c] = limit < MOST_LIMIT ? limit : MOST_LIMIT;
        }
    }

    static void bends_of_row(
        const int* __restrict__ up, const int* __restrict__ here, const int* __restrict__ down,
        const int* __restrict__ step, const int* __restrict__ limit,
        const unsigned char* __restrict__ keep, unsigned char* __restrict__ out, int reach,
        int lane, int n
    ) {
        for (int c = lane; c < n; c += Rows::LANES) {
            const int own = here[c], most = reach * step[c] << BITS, deep = limit[c] << (BITS + 1);
            const auto bends = [&](int before, int after) {
                const int b = apart(before, own), a = apart(after, own);
                return ((a > b ? a : b) < most) & (2 * own - before - after > deep);
            };
            out[c] = keep[c] & (bends(here[c - reach], here[c + reach]) | bends(up[c], down[c]));
        }
    }

    void bends(const Rows& rows) const {
        for (int r = rows.first; r < grid.rows; r += rows.step) {
            const int at = grid.row(r), none = grid.row(-1);
            // Without a row so far above or below there is no bend.
            const bool inside = r >= reach && r + reach < grid.rows;
            const int up = inside ? at - reach * grid.stride : none;
            const int down = inside ? at + reach * grid.stride : none;
            limits_of_row(limits, z + r * grid.columns, other + at, rows.lane, grid.columns);
            bends_of_row(
                smooth + up, smooth + at, smooth + down, steps + at, other + at,
                keep + r * grid.columns, found + at, reach, rows.lane, grid.columns
            );
        }
    }

    // The runs of found cells in row r, each a set of its own.
    void start_runs(int r) const {
        const Marks marks = {found + grid.row(r), grid.columns};
        int count = 0;
        for (int c = marks.next(0, 1); c < marks.n; c = marks.next(c, 1)) {
            const int begin = c;
            while (c < marks.n && marks.row[c]) ++c;
            runs.put(r, count, begin, c);
            runs.start(r, count++);
        }
        runs.counts[r] = count;
    }

    // Takes away 8-connected components of fewer than `least` cells.
    void without_small(const Team& team) const {
        for (int r = team.rank; r < grid.rows; r += team.size) start_runs(r);
        team.sync();
        for (int r = team.rank + 1; r < grid.rows; r += team.size) runs.link_all(team, r);
        team.sync();
        runs.measure(team);
        team.sync();
        for (int r = team.rank; r < grid.rows; r += team.size)
            for (int i = 0; i < runs.count(r); ++i)
                if (runs.sizes[runs.root(r, i)] < least)
                    for (int c = runs.begin(r, i); c < runs.end(r, i); ++c)
                        found[grid.row(r) + c] = 0;
        team.sync();
    }

    static void join_three(
        const unsigned char* __restrict__ a, const unsigned char* __restrict__ b,
        const unsigned char* __restrict__ c, unsigned char* __restrict__ out, int lane, int n
    ) {
        for (int i = lane; i < n; i += Rows::LANES) out[i] = a[i] | b[i] | c[i];
    }

    // One cell wider in all directions.
    void dilated(const Team& team, const Rows& rows) const {
        for (int r = rows.first; r < grid.rows; r += rows.step) {
            const unsigned char* row = found + grid.row(r);
            join_three(row - 1, row, row + 1, wide + grid.row(r), rows.lane, grid.columns);
        }
        team.sync();
        for (int r = rows.first; r < grid.rows; r += rows.step) {
            const unsigned char* row = wide + grid.row(r);
            join_three(
                row - grid.stride, row, row + grid.stride, found + grid.row(r), rows.lane,
                grid.columns
            );
        }
        team.sync();
    }

    // All threads must call it, after a sync; `found` may be read at once, kept or not.
    void run(const Team& team) const {
        const Rows rows(team);
        smoothed(rows, smooth, other);
        team.sync();
        smoothed(rows, other, smooth);
        team.sync();
        bends(rows);
        team.sync();
        without_small(team);
        for (int i = 0; i < margin; ++i) dilated(team, rows);
    }
};
