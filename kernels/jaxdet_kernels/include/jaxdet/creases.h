// Creases: concave edges, where depth is continuous but bends because two objects touch. Twin of
// `creases` in jaxdet/reference/_surfaces.py.
#pragma once
#include "bits.h"
#include "grid.h"
#include "runs.h"
#include "team.h"
#include "warp.h"

namespace jaxdet { namespace {

struct Creases {
    enum {
        BITS = 4,          // fraction bits of smoothed depths
        NONE = -(1 << 26)  // placeholder of a missing depth, far from all depths
    };
    Grid grid;
    // Distance of the cells between which the bend is measured, minimum number of cells of a crease,
    // and dilation [cells].
    int reach, least, margin;
    // Maximum depth step of a surface, at most 2^16, and limit of bends, at most 2^17, at each depth
    // [depth units].
    const int *steps, *limits;
    const int* z;  // (R, C) depth, 0 = none
    // Grids of cells with margins. `smooth` holds the depths with BITS fraction bits at first, then the
    // smoothed depths, and `other` those after the first smoothing; their margins are NONE. `step` holds
    // the value of `steps` for each cell.
    int *smooth, *other, *step;
    // Bitmap of the cells to process, and two bitmaps of scratch memory: crease cells, and run starts.
    BitRows kept, found, wide;
    Runs runs;  // of `found`, starting at `wide`

    static int apart(int a, int b) { return a < b ? b - a : a - b; }

    // Rounded mean of those of the 3 x 3 neighbours that differ by at most two steps. The sum of at most
    // nine depths below 2^20 is exact as a float. The quotient is below 2^20 and, unless it is an
    // integer, at least a ninth away from any integer, which is more than its rounding error.
    static int mean(int own, int step, int a, int b, int c, int d, int e, int f, int g, int h) {
        const int near = step << (BITS + 1), shift = near - own;
        int total = own, count = 1;
        const auto add = [&](int there) {
            const bool close = (unsigned)(there + shift) <= 2u * (unsigned)near;
            total += close ? there : 0;
            count += close ? 1 : 0;
        };
        add(a), add(b), add(c), add(d), add(e), add(f), add(g), add(h);
        const int mean = (int)((float)(total + (count >> 1)) / (float)count);
        return own < 0 ? (int)NONE : mean;
    }

    static bool bends(int own, int before, int after, int most, int deep) {
        const int b = apart(before, own), a = apart(after, own);
        return ((a > b ? a : b) < most) & (2 * own - before - after > deep);
    }

    // Smooths the rows near kept cells twice; `other` holds the result of the first pass. Ends in a sync.
    void smoothed(const Team& team) const {
        const Warp warp(team);
        for (int r = warp.index; r < grid.rows; r += warp.count) {
            if (!is_used(warp, r, reach + 1)) continue;
            const int at = grid.row(r);
            for (int c = warp.lane; c < grid.columns; c += warp.size)
                step[at + c] = steps[z[r * grid.columns + c]];
            smooth_row(warp, smooth + at, step + at, other + at);
        }
        team.sync();
        for (int r = warp.index; r < grid.rows; r += warp.count) {
            const int at = grid.row(r);
            if (is_used(warp, r, reach)) smooth_row(warp, other + at, step + at, smooth + at);
        }
        team.sync();
    }

    // Whether there are kept cells at most `around` rows away from a row. A collective call of a warp.
    bool is_used(const Warp& warp, int row, int around) const {
        const int from = row < around ? 0 : row - around;
        const int end = row + around < grid.rows ? row + around + 1 : grid.rows;
        unsigned some = 0;
        for (int i = kept.at(from, 0) + warp.lane; i < kept.at(end, 0); i += warp.size) some |= kept[i];
        return warp.ballot(some != 0);
    }

    // Smooths a row of a grid, given its first cell.
    void smooth_row(
        const Warp& warp, const int* here, const int* __restrict__ step, int* __restrict__ out
    ) const {
        const int *__restrict__ up = here - grid.stride, *__restrict__ own = here;
        const int* __restrict__ down = here + grid.stride;
        for (int c = warp.lane; c < grid.columns; c += warp.size)
            out[c] = mean(own[c], step[c], up[c - 1], up[c], up[c + 1], own[c - 1], own[c + 1],
                          down[c - 1], down[c], down[c + 1]);
    }

    // Finds the cells where depth bends more than the limit. Ends in a sync.
    void find(const Team& team) const {
        const auto is_kept = [&](int i) { return kept[i]; };
        Warp(team).fill(found, is_kept, [&](int i, int k) {
            const int r = found.row(i), at = grid.row(r) + found.column(i) + k;
            // Vertical bends are measured only if there are rows at that distance above and below.
            const bool inside = r >= reach && r + reach < grid.rows;
            const int none = grid.row(-1) - grid.row(r), away = reach * grid.stride;
            const int *const up = smooth + (inside ? -away : none);
            const int *const down = smooth + (inside ? away : none);
            const int most = reach * step[at] << BITS, deep = limits[z[found.cell(i, k)]] << (BITS + 1);
            return bends(smooth[at], smooth[at - reach], smooth[at + reach], most, deep) |
                   bends(smooth[at], up[at], down[at], most, deep);
        });
        team.sync();
    }

    // Removes 8-connected components of fewer than `least` cells. Ends in a sync.
    void without_small(const Team& team) {
        const int count = found.count(), words = found.at(1, 0);
        for (int i = team.rank; i < count; i += team.size) wide[i] = found[i] & ~found.before(i);
        team.sync();
        runs.number(team);
        for (int i = words + team.rank; i < count; i += team.size) {
            const int j = i - words;
            const unsigned here = found[i], above = found[j];
            const unsigned before = found.before(i), over = found.before(j);
            // Cells to link with the row above: the first cell of a run that touches a run of that row,
            // and cells that touch it only diagonally.
            unsigned straight = here & above & ~(before & over);
            unsigned left = here & ~above & over & ~before;
            unsigned right = here & ~above & found.after(j) & ~found.after(i);
            for (; straight; straight &= straight - 1) {
                const int k = BitRows::lowest(straight);
                runs.link(team, i, k, j, k);
            }
            for (; left; left &= left - 1) {
                const int k = BitRows::lowest(left);
                runs.link(team, i, k, k ? j : j - 1, (k + BitRows::WIDTH - 1) % BitRows::WIDTH);
            }
            for (; right; right &= right - 1) {
                const int k = BitRows::lowest(right), last = BitRows::WIDTH - 1;
                runs.link(team, i, k, k < last ? j : j + 1, (k + 1) % BitRows::WIDTH);
            }
        }
        team.sync();
        runs.measure(team);
        for (int i = team.rank; i < count; i += team.size) {
            unsigned large = 0;
            for (unsigned rest = found[i]; rest;) {
                const unsigned cells = runs.next(i, &rest);
                const int root = runs.sets.find(runs.at(i, BitRows::lowest(cells)));
                if (runs.sizes[root] >= least) large |= cells;
            }
            found[i] = large;
        }
        team.sync();
    }

    // Dilates by one cell in all directions; the result is `to`. Ends in a sync.
    void dilate(const Team& team, const BitRows& from, const BitRows& to) const {
        const int count = from.count(), words = from.at(1, 0);
        const auto wider = [&](int i) { return from[i] | from.before(i) | from.after(i); };
        for (int i = team.rank; i < count; i += team.size) {
            unsigned all = wider(i);
            if (i >= words) all |= wider(i - words);
            if (i + words < count) all |= wider(i + words);
            to[i] = all;
        }
        team.sync();
    }

    // Returns the bitmap of crease cells, including those that are not in `kept`. All threads of the team
    // must call it after a sync. Ends in a sync.
    BitRows run(const Team& team) {
        smoothed(team);
        find(team);
        without_small(team);
        for (int k = 0; k < margin; ++k) {
            dilate(team, found, wide);
            const BitRows other = found;
            found = wide;
            wide = other;
        }
        return found;
    }
};

} }  // namespace jaxdet
