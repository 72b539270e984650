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
        BITS = 4,           // fraction bits of smoothed depths
        NONE = -(1 << 26),  // placeholder of a missing depth, far from all depths
        // On CUDA a warp smooths SEGMENT rows of a strip of columns; the outer HALO columns on each
        // side belong to the neighbouring strips. AHEAD rows are loaded at a time.
        HALO = 2,
        SEGMENT = 24,
        AHEAD = 4
    };
    Grid grid;
    // Distance of the cells between which the bend is measured, minimum number of cells of a crease,
    // and dilation [cells].
    int reach, least, margin;
    // Maximum depth step of a surface, at most 2^16, and limit of bends, at most 2^17, at each depth
    // [depth units].
    const int *steps, *limits;
    const int* z;  // (R, C) depth, 0 = none
    // Grids of cells. `smooth` holds the smoothed depths, with margins of NONE. `other` and `step` are used
    // only on the CPU, in rows near kept cells: the depths after the first smoothing, with margins of
    // NONE, and the value of `steps` for each cell.
    int *smooth, *other, *step;
    // Bitmap of the cells to process, and two bitmaps of scratch memory: crease cells, and run starts.
    BitRows kept, found, wide;
    Runs runs;  // runs of the cells in `found`; `wide` marks their first cells

    static int apart(int a, int b) { return a < b ? b - a : a - b; }

    // Rounded mean of a cell and those of its eight neighbours that differ from it by at most two steps.
    // The sum of at most nine depths below 2^20 is exact as a float. The quotient is below 2^20 and, unless
    // it is an integer, at least a ninth away from any integer, which is more than its rounding error.
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

#if defined(__CUDA_ARCH__)
    // Window of 3 x 3 cells, with the newest row last. Each lane holds the window of its own column.
    struct Window {
        int left[3], own[3], right[3];

        void push(int value) {
            for (int k = 0; k < 2; ++k) {
                left[k] = left[k + 1];
                own[k] = own[k + 1];
                right[k] = right[k + 1];
            }
            left[2] = __shfl_up_sync(0xffffffff, value, 1);
            own[2] = value;
            right[2] = __shfl_down_sync(0xffffffff, value, 1);
        }

        int mean(int step) const {
            return Creases::mean(own[1], step, left[0], own[0], right[0], left[1], right[1],
                                 left[2], own[2], right[2]);
        }
    };

    // Smooths the depths twice in one pass down strips of columns.
    void smoothed(const Team& team) const {
        enum { INNER = Warp::size - 2 * HALO };
        const Warp warp(team);
        const int strips = (grid.columns + INNER - 1) / INNER;
        const int pieces = strips * ((grid.rows + SEGMENT - 1) / SEGMENT);
        for (int piece = warp.index; piece < pieces; piece += warp.count) {
            const int c = piece % strips * INNER + warp.lane - HALO;
            const bool inside = c >= 0 && c < grid.columns;
            const bool own = inside && warp.lane >= HALO && warp.lane < Warp::size - HALO;
            const int begin = piece / strips * SEGMENT, stop = begin + SEGMENT;
            const int end = stop < grid.rows ? stop : grid.rows;
            Window measured, once;
            for (int k = 0; k < 3; ++k) {
                measured.left[k] = measured.own[k] = measured.right[k] = NONE;
                once.left[k] = once.own[k] = once.right[k] = NONE;
            }
            int near_last = 0, near_before = 0;
            for (int first = begin - HALO; first < end + HALO; first += AHEAD) {
                int depth[AHEAD], near[AHEAD];
                for (int k = 0; k < AHEAD; ++k) {
                    const int r = first + k;
                    const bool there = inside && r >= 0 && r < grid.rows;
                    depth[k] = there ? z[r * grid.columns + c] : 0;
                }
                for (int k = 0; k < AHEAD; ++k) near[k] = steps[depth[k]];
                for (int k = 0; k < AHEAD; ++k) {
                    measured.push(depth[k] > 0 ? depth[k] << BITS : (int)NONE);
                    once.push(measured.mean(near_last));
                    const int r = first + k - HALO, twice = once.mean(near_before);
                    if (own && r >= begin && r < end) smooth[grid.row(r) + c] = twice;
                    near_before = near_last;
                    near_last = near[k];
                }
            }
        }
        team.sync();
    }
#else
    static void smooth_row(
        const int* __restrict__ up, const int* __restrict__ here, const int* __restrict__ down,
        const int* __restrict__ step, int* __restrict__ out, int n
    ) {
        for (int c = 0; c < n; ++c)
            out[c] = mean(here[c], step[c], up[c - 1], up[c], up[c + 1], here[c - 1], here[c + 1],
                          down[c - 1], down[c], down[c + 1]);
    }

    // Smooths the rows near kept cells twice; `other` holds the result of the first pass.
    void smoothed(const Team& team) const {
        const int wide = grid.stride, n = grid.columns;
        grid.frame(team, other, NONE);
        int used[Grid::MOST_COLUMNS];
        for (int r = 0; r < grid.rows; ++r) {
            used[r] = 0;
            for (int w = 0; w < kept.words; ++w) used[r] |= kept[kept.at(r, w)] != 0;
        }
        const auto is_used = [&](int r, int around) {
            int some = 0;
            for (int k = r - around; k <= r + around; ++k)
                some |= k >= 0 && k < grid.rows ? used[k] : 0;
            return some;
        };
        for (int r = 0; r < grid.rows; ++r) {
            if (!is_used(r, reach + 2)) continue;
            const int at = grid.row(r), *depths = z + r * n;
            for (int c = 0; c < n; ++c) {
                smooth[at + c] = depths[c] > 0 ? depths[c] << BITS : (int)NONE;
                step[at + c] = steps[depths[c]];
            }
        }
        for (int r = 0; r < grid.rows; ++r) {
            if (!is_used(r, reach + 1)) continue;
            const int at = grid.row(r), *here = smooth + at;
            smooth_row(here - wide, here, here + wide, step + at, other + at, n);
        }
        for (int r = 0; r < grid.rows; ++r) {
            if (!is_used(r, reach)) continue;
            const int* here = other + grid.row(r);
            smooth_row(here - wide, here, here + wide, step + grid.row(r), smooth + grid.row(r), n);
        }
    }
#endif

    // Finds the cells where depth bends more than the limit. Vertical bends are measured only in rows
    // that have rows at the distance `reach` above and below.
    void find(const Team& team) const {
        const Warp warp(team);
        for (int i = warp.index; i < found.count(); i += warp.count) {
            const int r = found.row(i), c = found.column(i), at = grid.row(r) + c, away = reach;
            const bool inside = r >= away && r + away < grid.rows;
            const int none = grid.row(-1) + c, over = away * grid.stride;
            const int *here = smooth + at, *up = smooth + (inside ? at - over : none);
            const int *down = smooth + (inside ? at + over : none), *depths = z + r * grid.columns + c;
            const int *const steps = this->steps, *const limits = this->limits;
            const unsigned bent = !kept[i] ? 0 : warp.bits(grid.columns - c, [=](int k) {
                const int most = away * steps[depths[k]] << BITS, deep = limits[depths[k]] << (BITS + 1);
                return bends(here[k], here[k - away], here[k + away], most, deep) |
                       bends(here[k], up[k], down[k], most, deep);
            });
            if (warp.lane == 0) found[i] = bent & kept[i];
        }
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
        grid.frame(team, smooth, NONE);
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
