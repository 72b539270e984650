// Positions of cells relative to the floor, and segmentation of cells into surfaces. Twin of
// `_surfaces` in jaxdet/reference/_detect.py and of jaxdet/reference/_surfaces.py.
#pragma once
#include "arena.h"
#include "bits.h"
#include "creases.h"
#include "floor_noise.h"
#include "grid.h"
#include "runs.h"
#include "team.h"
#include "warp.h"

namespace jaxdet { namespace {

struct Surfaces {
    enum {
        MOST = 512,  // number of labels; cells of further surfaces get the label -1
        UNSEEN = 0x7fffffff,
    };
    // Indices of settings; lengths are in depth units. NEAREST and FARTHEST: depth range of surfaces.
    // CREASE_CELLS, MIN_CELLS and CREASE_MARGIN: radius, minimum size and dilation of creases [cells].
    // BENT: height up to which surfaces without a steep side are floor. NOISE: maximum noise of the floor
    // per depth and per height of the camera, see FloorNoise. HIGHEST: height above which the robot passes
    // below obstacles. IN_RANGE: end of the depth range. HOLE: largest hole [cells].
    enum {
        NEAREST, FARTHEST, CREASE_CELLS, MIN_CELLS, CREASE_MARGIN, BENT, NOISE, HIGHEST, IN_RANGE,
        HOLE, SETTINGS
    };
    int rows, columns;
    const int *x, *y, *z;  // (R, C): positions of cells in the camera; z is 0 for unmeasured cells
    const int* floor;
    // Maximum depth step of a surface, at most 2^16; limit of bends, at most 2^17; and height up to
    // which cells are floor, at each depth [depth units].
    const int *steps, *limits, *rises;
    const int* settings;
    int *right, *forward, *height, *label_out;  // (R, C): position on the floor, and label
    unsigned char *keep, *free, *low, *half;    // (R, C): masks, see `Found` in the reference
    int* count_out;
    int* has_depth_out;  // whether any depth is in range
    int* scratch;

    // Scratch memory of a team.
    struct Parts {
        Grid grid;
        int *depth, *other, *step;  // grids of cells, see `Creases`
        // `parent` and `label` have a value per run. The other arrays have a value per surface, at the
        // index of its root run: number of cells; first cell; top; and `level`, a sum over its cells that
        // are directly above a floor cell: 2 per cell, minus 3 if the side of the cell is steep.
        int *parent, *label, *sizes, *first, *top, *level;
        // Bitmaps of cells, and the number of runs that begin before each word. On CUDA these arrays are in
        // shared memory if they fit there.
        BitRows kept, on, starts, up;
        int* before;

        Parts(int rows, int columns, Arena& arena)
            : grid(rows, columns), kept(rows, columns, nullptr), on(kept), starts(kept), up(kept) {
            arena.take(grid.size, depth, other, step);
            arena.take(rows * columns, parent, label, sizes, first, top, level);
            arena.take(5 * kept.count() + 1, before);
            const int count = kept.count();
#if defined(__CUDA_ARCH__)
            enum { SHARED = 8192 };
            __shared__ int shared[SHARED];
            if (5 * count < SHARED) before = shared;
#endif
            kept.bits = (unsigned*)(before + count + 1);
            on.bits = kept.bits + count;
            starts.bits = on.bits + count;
            up.bits = starts.bits + count;
        }

        // Returns the runs of the cells of a bitmap; `firsts` is the bitmap of the runs' first cells.
        Runs runs(const BitRows& cells, const BitRows& firsts) const {
            return {cells, firsts, before, {parent}, sizes};
        }
    };

    // Transforms a cell to the floor frame.
    void place(const FloorFrame& frame, int k) const {
        const int a = x[k], b = y[k], d = z[k], ahead = frame.forward(a, b, d);
        right[k] = frame.right(a, b, d);
        forward[k] = ahead;
        height[k] = frame.level(a, b, d) - (frame.has_ramp() ? frame.rise(ahead) : 0);
    }

    // Classifies a cell; returns whether it is kept. Cells no higher than `rise` are floor.
    __attribute__((always_inline)) bool classify(bool is_known, int k, int rise) const {
        const int d = z[k], high = height[k];
        const bool above = high > rise;
        const bool below = (high <= settings[HIGHEST]) | !is_known;
        const bool on = (d >= settings[NEAREST]) & (d <= settings[FARTHEST]) & above & below;
        keep[k] = on;
        free[k] = (d >= settings[NEAREST]) & !on;
        low[k] = (d > 0) & !above;
        half[k] = (d > 0) & (2 * high > rise);
        return on;
    }

    bool in_range(int d) const { return (d >= settings[NEAREST]) & (d <= settings[IN_RANGE]); }

    // Transforms and classifies all cells; returns whether the depth of any of this thread's cells is
    // in range. Ends in a sync.
    bool start(const Team& team, const BitRows& kept) const {
        JAXDET_SHARED int sums[FloorNoise::COUNTS];
        const FloorFrame frame(floor);
        const int cells = rows * columns;
        JAXDET_VECTORIZE
        for (int k = team.rank; k < cells; k += team.size) place(frame, k);
        team.sync();
        const FloorNoise noise{z, height, cells, settings[NEAREST], settings[FARTHEST], rises[0], sums};
        const int slope = noise.slope(team, FloorNoise::most(frame, settings[NOISE]));
        const Warp warp(team);
        int some = 0;
        for (int i = warp.index; i < kept.count(); i += warp.count) {
            const int c = kept.column(i), first = kept.row(i) * columns + c;
            const unsigned on = warp.bits(columns - c, [=, &some](int n) {
                const int k = first + n, d = z[k], noisy = d * slope >> FloorNoise::SLOPE_BITS;
                some |= in_range(d);
                return classify(frame.valid, k, rises[d] > noisy ? rises[d] : noisy);
            });
            if (warp.lane == 0) kept[i] = on;
        }
        team.sync();
        return some;
    }

    static bool is_near(int z_one, int z_other, int step_one, int step_other) {
        return Creases::apart(z_one, z_other) <= (step_one < step_other ? step_one : step_other);
    }

    // Finds `starts`, the first cells of runs of linked cells, and `up`, cells linked to the cell above.
    void find_links(const Team& team, const Parts& in) const {
        const BitRows &on = in.on, &starts = in.starts, &up = in.up;
        const Warp warp(team);
        for (int i = warp.index; i < on.count(); i += warp.count) {
            unsigned goes_on = 0, linked = 0;
            if (on[i]) {
                const int* const steps = this->steps;
                const int r = on.row(i), c = on.column(i), from = c ? 0 : 1;
                const int *here = z + r * columns + c, *above = here - columns;
                goes_on = warp.bits(columns - c - from, [=](int k) {
                    return is_near(here[from + k], here[from + k - 1], steps[here[from + k]],
                                   steps[here[from + k - 1]]);
                }) << from;
                linked = !r ? 0 : warp.bits(columns - c, [=](int k) {
                    return is_near(here[k], above[k], steps[here[k]], steps[above[k]]);
                });
            }
            if (warp.lane) continue;
            starts[i] = on[i] & ~(on.before(i) & goes_on);
            up[i] = on[i] & on.above(i) & linked;
        }
        team.sync();
    }

    // Links cells of a row or a column across holes (unmeasured cells), if depth is continuous.
    void link_across_holes(const Team& team, const Runs& runs) const {
        const BitRows& on = runs.on;
        if (!settings[HOLE]) return;
        for (int i = team.rank; i < on.count(); i += team.size) {
            if (!on[i]) continue;
            const int r = on.row(i), first = on.column(i);
            for (unsigned rest = on[i] & ~on.after(i); rest; rest &= rest - 1) {
                const int k = BitRows::lowest(rest), c = first + k;
                const int n = across(r * columns + c, 1, columns - c);
                if (!n) continue;
                const int there = c + n, j = on.at(r, there / BitRows::WIDTH);
                const int l = there % BitRows::WIDTH;
                if (on[j] >> l & 1) runs.link(team, i, k, j, l);
            }
            for (unsigned rest = on[i] & ~on.below(i); rest; rest &= rest - 1) {
                const int k = BitRows::lowest(rest), c = first + k;
                const int n = across(r * columns + c, columns, rows - r);
                if (!n) continue;
                const int j = on.at(r + n, c / BitRows::WIDTH);
                if (on[j] >> k & 1) runs.link(team, i, k, j, k);
            }
        }
    }

    // Number of steps from a cell to the measured cell behind a hole, 0 if there is no hole or depth is
    // not continuous across it. Cells are `away` elements apart, and there are
    // `most` of them from this cell on.
    int across(int cell, int away, int most) const {
        const int end = most < settings[HOLE] + 2 ? most : settings[HOLE] + 2;
        for (int n = 1; n < end; ++n) {
            const int there = cell + n * away;
            if (!z[there]) continue;
            const bool near = n > 1 && is_near(z[cell], z[there], steps[z[cell]], steps[z[there]]);
            return near ? n : 0;
        }
        return 0;
    }

    // Labels linked cells with the root of their component, small ones with -1. Returns the number of
    // runs; `has` becomes the bitmap of labelled cells. Ends in a sync.
    int label(const Team& team, const Parts& in, Runs& runs, const BitRows& up, const BitRows& has) const {
        const BitRows &on = runs.on, &starts = runs.starts;
        const int count = on.count(), words = on.at(1, 0), least = settings[MIN_CELLS];
        const int all = runs.number(team);
        for (int i = words + team.rank; i < count; i += team.size) {
            const int j = i - words;
            // The first cell where two runs touch.
            unsigned meet = up[i] & ~(up.before(i) & ~starts[i] & ~starts[j]);
            for (; meet; meet &= meet - 1) {
                const int k = BitRows::lowest(meet);
                runs.link(team, i, k, j, k);
            }
        }
        team.sync();
        for (int run = team.rank; run < all; run += team.size)
            in.label[run] = runs.sets.find(run);
        team.sync();
        link_across_holes(team, runs);
        team.sync();
        runs.measure(team);
        for (int run = team.rank; run < all; run += team.size) {
            if (runs.sizes[runs.sets.find(run)] < least) in.label[run] = -1;
            in.first[run] = UNSEEN;
            in.top[run] = -1;
            in.level[run] = 0;
        }
        team.sync();
#if defined(__CUDA_ARCH__)
        const Warp warp(team);
        for (int i = warp.index; i < count; i += warp.count) {
            const int c = on.column(i) + warp.lane;
            const int own = on[i] >> warp.lane & 1 ? in.label[runs.at(i, warp.lane)] : -1;
            if (c < columns) label_out[on.row(i) * columns + c] = own;
            const unsigned those = warp.ballot(own >= 0);
            if (warp.lane == 0) has[i] = those;
        }
#else
        for (int i = 0; i < count; ++i) {
            const int first = on.column(i);
            const int n = columns - first < BitRows::WIDTH ? columns - first : (int)BitRows::WIDTH;
            int* out = label_out + on.row(i) * columns + first;
            for (int c = 0; c < n; ++c) out[c] = -1;
            unsigned those = 0;
            for (unsigned rest = on[i]; rest;) {
                const unsigned part = runs.next(i, &rest);
                const int begin = BitRows::lowest(part), own = in.label[runs.at(i, begin)];
                if (own < 0) continue;
                those |= part;
                const int end = begin + BitRows::popcount(part);
                for (int c = begin; c < end; ++c) out[c] = own;
            }
            has[i] = those;
        }
#endif
        team.sync();
        return all;
    }

    // Region growing, breadth first: a kept cell without a label takes the label of the neighbour that
    // is nearest in depth. Labels that are set in a round are used from the next round on, as marked in
    // `has`. Returns the bitmap of labelled cells. Ends in a sync.
    BitRows grow(const Team& team, const BitRows& kept, BitRows has, BitRows next) const {
        const Warp warp(team);
        const int rounds = settings[CREASE_CELLS] + settings[CREASE_MARGIN] + 1;
        for (int round = 0; round < rounds; ++round) {
            bool some = false;
            // Each lane tests whether a word has such cells; then all lanes process these words one by
            // one.
            for (int first = warp.index * Warp::size; first < has.count();
                 first += warp.count * Warp::size) {
                const int own = first + warp.lane;
                const bool open = own < has.count() && (kept[own] & ~has[own]) &&
                                  Neighbours(has, own).free(kept, has, own);
                unsigned taken = 0;
                for (unsigned rest = warp.ballot(open); rest; rest &= rest - 1) {
                    const int lane = BitRows::lowest(rest);
                    const unsigned those = take_all(warp, kept, has, first + lane);
                    if (warp.lane == lane) taken = those;
                }
                if (own < has.count()) next[own] = has[own] | taken;
                some |= taken != 0;
            }
            if (!team.any(some)) break;
            const BitRows other = has;
            has = next;
            next = other;
        }
        return has;
    }

    // Four bitmaps: the cells of a word whose left, right, upper or lower neighbour has a label.
    struct Neighbours {
        unsigned left, right, upper, lower;

        Neighbours(const BitRows& has, int i)
            : left(has.before(i)), right(has.after(i)), upper(has.above(i)), lower(has.below(i)) {}
        // Cells without a label that may take one.
        unsigned free(const BitRows& kept, const BitRows& has, int i) const {
            return kept[i] & ~has[i] & (left | right | upper | lower);
        }
    };

    // Labels the cells of a word; returns the bitmap of newly labelled cells. All lanes of the warp
    // must call it with the same word.
    unsigned take_all(
        [[maybe_unused]] const Warp& warp, const BitRows& kept, const BitRows& has, int i
    ) const {
        const Neighbours labelled(has, i);
        unsigned free = labelled.free(kept, has, i), taken = 0;
        const int at = has.row(i) * columns + has.column(i);
        const auto takes = [&](int k) {
            return take(at + k, labelled.left >> k & 1, labelled.right >> k & 1,
                        labelled.upper >> k & 1, labelled.lower >> k & 1);
        };
#if defined(__CUDA_ARCH__)
        taken = warp.ballot(free >> warp.lane & 1 && takes(warp.lane));
#else
        for (; free; free &= free - 1)
            taken |= (unsigned)takes(BitRows::lowest(free)) << BitRows::lowest(free);
#endif
        return taken;
    }

    // Gives a cell the label of the neighbour nearest in depth, among those within the step; of equally
    // near neighbours, the first in the order left, right, upper, lower. Returns whether there is one.
    bool take(int cell, bool left, bool right, bool upper, bool lower) const {
        const int depth = z[cell];
        int best = steps[depth] + 1, from = -1;
        const auto try_label = [&](bool has, int there) {
            if (!has) return;
            const int apart = Creases::apart(z[there], depth);
            if (apart >= best) return;
            best = apart;
            from = there;
        };
        try_label(left, cell - 1);
        try_label(right, cell + 1);
        try_label(upper, cell - columns);
        try_label(lower, cell + columns);
        if (from >= 0) label_out[cell] = label_out[from];
        return from >= 0;
    }

    // Whether the side of a surface above floor is steep; it rises by `rises` and recedes by `goes`
    // [depth units]. `outer` is true in the margins of the image.
    bool is_steep(int rises, int goes, bool outer) const {
        const int away = goes < 0 ? -goes : goes;
        return outer ? rises > away : 3 * rises > goes;
    }

    // Measures all surfaces. `sizes` becomes 1 for a surface that has a lowest cell with floor below, a
    // cell inside the margins, or a cell at the lower edge of the image. Ends in a sync.
    void measure(const Team& team, const Parts& in, int runs, const BitRows& has) const {
        for (int run = team.rank; run < runs; run += team.size) in.sizes[run] = 0;
        team.sync();
        const Margins margins(columns);
        for (int i = team.rank; i < has.count(); i += team.size) {
            const int r = has.row(i), k = r * columns;
            const int* label = label_out + k + has.column(i);
            for (unsigned rest = has[i]; rest;) {
                // A run of adjacent cells with one label.
                const int first = BitRows::lowest(rest), own = label[first];
                int next = first;
                for (; next < BitRows::WIDTH && rest >> next & 1 && label[next] == own; ++next)
                    rest &= ~(1u << next);
                const int begin = has.column(i) + first, end = has.column(i) + next;
                int top = -1, pairs = 0, steep = 0;
                for (int c = begin; c < end; ++c) top = height[k + c] > top ? height[k + c] : top;
                if (r + 1 < rows)
                    for (int c = begin; c < end; ++c) {
                        const int rises = height[k + c] - height[k + c + columns];
                        const int goes = forward[k + c] - forward[k + c + columns];
                        const int lowest = low[k + c + columns];
                        pairs += lowest;
                        steep += lowest & (int)is_steep(rises, goes, margins.has(c));
                    }
                const bool inner = begin < columns - margins.width && end > margins.width;
                const int level = 2 * pairs - 3 * steep;
                team.atomic_min(in.first + own, k + begin);
                team.atomic_max(in.top + own, top);
                if (level) team.atomic_add(in.level + own, level);
                if (pairs || r + 1 == rows || inner) in.sizes[own] = 1;
            }
        }
        team.sync();
    }

    // Whether a surface is floor that appears to bend upwards because of errors of the sensor.
    bool is_bent(const Parts& in, int label) const {
        const bool flat = in.level[label] > 0 || !in.sizes[label];
        return flat && in.top[label] <= settings[BENT];
    }

    // Numbers the surfaces in the order of their first cells, and removes bent floor.
    void number(
        const Team& team, const Parts& in, const Runs& runs, int all, const BitRows& has
    ) const {
        const BitRows& firsts = runs.starts;
        const auto is_surface = [&](int run) { return in.label[run] == run; };
        const auto word_of = [&](int cell) {
            return firsts.at(cell / columns, cell % columns / BitRows::WIDTH);
        };
        const auto bit_of = [&](int cell) { return 1u << cell % columns % BitRows::WIDTH; };
        for (int i = team.rank; i < firsts.count(); i += team.size) firsts[i] = 0;
        team.sync();
        for (int run = team.rank; run < all; run += team.size)
            if (is_surface(run) && !is_bent(in, run))
                team.atomic_or((int*)firsts.bits + word_of(in.first[run]),
                               (int)bit_of(in.first[run]));
        team.sync();
        const int count = runs.count(team);
        if (team.rank == 0) *count_out = count;
        int* const numbers = in.level;
        for (int run = team.rank; run < all; run += team.size) {
            if (!is_surface(run)) continue;
            const int i = word_of(in.first[run]);
            const unsigned bit = bit_of(in.first[run]);
            const bool bent = is_bent(in, run);
            numbers[run] = bent ? -1 : runs.before[i] + BitRows::popcount(firsts[i] & (bit - 1));
        }
        team.sync();
        const Warp warp(team);
        for (int i = warp.index; i < has.count(); i += warp.count) {
            if (!has[i]) continue;
            const int first = has.row(i) * columns + has.column(i);
            warp.each_bit(has[i], [&](int k) {
                const int number = numbers[label_out[first + k]];
                label_out[first + k] = number < MOST ? number : -1;
                if (number >= 0) return;
                keep[first + k] = 0;
                free[first + k] = 1;
            });
        }
        team.sync();
    }

    // Finds the surfaces of a frame. All threads of the team must call it.
    void run(const Team& team) const {
        Arena arena{scratch};
        const Parts in(rows, columns, arena);
        const BitRows &kept = in.kept, &on = in.on, &starts = in.starts, &up = in.up;
        const bool some = team.any(start(team, kept));
        if (team.rank == 0) *has_depth_out = some;
        Creases creases = {
            in.grid, settings[CREASE_CELLS], settings[MIN_CELLS], settings[CREASE_MARGIN],
            steps, limits, z, in.depth, in.other, in.step, kept, starts, up, in.runs(starts, up),
        };
        const BitRows crease = creases.run(team);
        for (int i = team.rank; i < on.count(); i += team.size) on[i] = kept[i] & ~crease[i];
        team.sync();
        find_links(team, in);
        Runs runs = in.runs(on, starts);
        const int all = label(team, in, runs, up, up);
        const BitRows has = grow(team, kept, up, on);
        measure(team, in, all, has);
        number(team, in, runs, all, has);
    }
};

} }  // namespace jaxdet
