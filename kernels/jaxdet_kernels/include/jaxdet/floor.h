// Estimates the floor of a frame from its own cells. Twin of `_find` in jaxdet/reference/_floor.py,
// which documents the constants.
#pragma once
#include "arena.h"
#include "floor_ahead.h"
#include "floor_frame.h"
#include "floor_planes.h"
#include "floor_search.h"
#include "grid.h"

namespace jaxdet { namespace {

// Frame of the detected floor, or the fallback frame if that floor was refused. Twin of `axes` in
// jaxdet/floor/frame.py and of `slopes` in jaxdet/floor/units.py.
struct FoundFrame {
    // Indices of the results of `Floor`.
    enum { PITCH, ROLL, HEIGHT, START, TURN, ON, ALL, REFUSED, RESULTS };
    FloorAngles angles;

    // Writes the frame of the floor `found` (RESULTS values) to `out`, or `given` if no floor was
    // accepted; both have FloorFrame::VALUES values.
    void run(const int* found, const int* given, int* out) const {
        if (found[REFUSED]) {
            for (int i = 0; i < FloorFrame::VALUES; ++i) out[i] = given[i];
            return;
        }
        enum { BITS = FloorFrame::BITS, SHIFT = FloorAngles::SLOPE_BITS - BITS };
        const FloorPlane plane = {found[PITCH], found[ROLL], found[HEIGHT]};
        const FloorDirection right = angles.right(plane, BITS), forward = angles.forward(plane, BITS);
        const FloorDirection down = angles.down(plane, BITS);
        const int slope = (angles.slope(found[TURN]) + (1 << (SHIFT - 1))) >> SHIFT;
        const int values[FloorFrame::VALUES] = {
            right.x, right.y, right.z, forward.x, forward.y, forward.z, down.x, down.y, down.z,
            plane.height, 1, found[START], slope,
        };
        for (int i = 0; i < FloorFrame::VALUES; ++i) out[i] = values[i];
    }
};

struct Floor {
    enum { MIN_CELLS = 50, FAR_GAIN = 5, OBSTACLE = 95 };
    enum { UNDER = 10, UNDER_PART = 2, UNDER_ALONE = 3, UNDER_PART_ALONE = 8 };
    // Reasons of a refusal.
    enum { NONE, TOO_LITTLE, MOSTLY_OBSTACLE, FAR, TABLE };
    // Indices of `counts`. ALL, INNER, BEFORE and BEYOND: numbers of cells. From ENDS on, one per ring: the
    // index in `few` after the last cell of the ring. From NEXT on, one per ring: the index in `few` at
    // which `take` writes the next cell of the ring.
    enum { ALL, INNER, BEFORE, BEYOND, ENDS, NEXT = ENDS + FloorSearch::RINGS };
    enum {
        COUNTS = NEXT + FloorSearch::RINGS,
        // Numbers of integers of the prior and of the result.
        PRIOR = 4,
        RESULTS = FoundFrame::RESULTS,
        // Maximum number of planes that are scored together; a search near a guess has fewer.
        PLANES = FloorSearch::ANY_PLANES,
        MOST_THREADS = 256,
        // Number of words of shared memory on CUDA; five blocks fit on a multiprocessor with 228 KB. On the
        // CPU no such memory is used.
        SHARED = Warp::size > 1 ? 11264 : 1
    };
    const Team& team;
    const FloorSettings* settings;
    FloorAngles angles;
    FloorPlane prior;
    bool has_prior;
    // Scratch.
    unsigned long long *sums, *keys;
    int *counts, *planes, *votes, *most_ramp, *slack, *weights, *rows, *places, *lattice, *ends;
    // `cells`, `few` and `inner` are samples that `take` describes. `parts` has the cells before and, from
    // its end backwards, the cells beyond the start of a ramp or a step.
    FloorCells cells, parts, few, inner;
    int room;

    // Allocates the arrays. On CUDA `fast` is shared memory of SHARED words. First the arrays that are
    // always needed are placed there. Those that are used one after the other share the words that are
    // left, each if it fits.
    Floor(const Team& team, const FloorSettings* settings, const int* sines, const int* prior_in, int rows_in,
          int columns_in, Arena& arena, int* fast)
        : team(team), settings(settings), angles{sines}, prior{prior_in[0], prior_in[1], prior_in[2]},
          has_prior(prior_in[3] != 0) {
        const int stride = settings->stride;
        const int r = part(rows_in, stride), c = part(columns_in, stride);
        const int most = r * c, most_few = ((r + 1) / 2) * ((c + 1) / 2);
        int* quick = fast;
        room = Warp::size > 1 ? (int)SHARED : 0;
        const auto always = [&](int words) {
            if (words > room) return arena.words(words);
            int* const place = quick;
            quick += words;
            room -= words;
            return place;
        };
        sums = (unsigned long long*)always(ThreadGroup::words(team));
        keys = (unsigned long long*)always(FloorSearch::KEY_WORDS);
        counts = always(COUNTS);
        planes = always(2 * 3 * PLANES);
        votes = always(PLANES);
        most_ramp = always(PLANES);
        rows = always(FloorProfile::ROW_ARRAYS * (settings->runs + 1));
        const auto now = [&](int words) { return words <= room ? quick : arena.words(words); };
        const auto positions = [&](int count) {
            return FloorCells{arena.words(count), arena.words(count), arena.words(count), count};
        };
        cells = positions(most);
        parts = positions(most);
        few = positions(most_few);
        inner = positions(most_few);
        slack = arena.words(most_few);
        places = now(4 * most_few);
        const int groups = MOST_THREADS / 32 * most_few;  // a word per cell and warp
        weights = now(groups > most ? groups : most);
        const int bins = FloorSearch::most_bins(settings);
        ends = room ? quick : arena.words(FloorVotes::LANES * bins);
        lattice = arena.words(FloorSearch::lattice_words(settings));
    }

    // Number of sampled cells along a side of `size` cells: every `stride`-th, from index stride / 2.
    int part(int size, int stride) const {
        return size > stride / 2 ? (size - stride / 2 + stride - 1) / stride : 0;
    }

    // Collects the measured cells of the sample in `cells`, those of every second of its rows and
    // columns in `few`, sorted by ring, and those of `few` inside the margins in `inner`.
    void take(const int* x, const int* y, const int* z, int rows, int columns) const {
        const int stride = settings->stride, half = stride / 2;
        const int r = part(rows, stride), c = part(columns, stride);
        const Margins margins(c);
        const int deepest = settings->max_depth;
        const int* rings = settings->rings;
        for (int k = team.rank; k < COUNTS; k += team.size) counts[k] = 0;
        team.sync();
        const auto ring_of = [&](int depth) {
            int ring = 0;
            for (int n = 0; n < FloorSearch::RINGS - 1; n++) ring += rings[n] < depth;
            return ring;
        };
        // Calls `use` with the row, the column and the index of each measured cell in every `step`-th
        // row and column of the sample.
        const auto each_cell = [&](int step, auto use) {
            const int down = (r + step - 1) / step, across = (c + step - 1) / step;
            for (int i = team.rank; i < down * across; i += team.size) {
                const int row = i / across * step, column = i % across * step;
                const int p = (half + row * stride) * columns + half + column * stride;
                if ((z[p] > 0) & (z[p] <= deepest)) use(row, column, p);
            }
            team.sync();
        };
        each_cell(1, [&](int row, int column, int p) {
            cells.put(team.atomic_count(counts + ALL), x[p], y[p], z[p]);
            if (((row | column) & 1) == 0) team.atomic_count(counts + ENDS + ring_of(z[p]));
        });
        if (team.rank == 0) {
            int sum = 0;
            for (int n = 0; n < FloorSearch::RINGS; n++) {
                counts[NEXT + n] = sum;
                counts[ENDS + n] = sum += counts[ENDS + n];
            }
        }
        team.sync();
        each_cell(2, [&](int, int column, int p) {
            few.put(team.atomic_count(counts + NEXT + ring_of(z[p])), x[p], y[p], z[p]);
            if (!margins.has(column)) inner.put(team.atomic_count(counts + INNER), x[p], y[p], z[p]);
        });
    }

    // Writes the floor to `out`: the RESULTS integers that `floor_fit` in jaxdet/floor/units.py
    // documents.
    void run(const int* x, const int* y, const int* z, int rows, int columns, int* out) const {
        take(x, y, z, rows, columns);
        const int number = counts[ENDS + FloorSearch::RINGS - 1];
        if (number < MIN_CELLS) {
            const FloorPlane plane = has_prior ? prior : FloorPlane{0, 0, 0};
            write(out, plane, {}, {0, 0, TOO_LITTLE});
        } else {
            find(number, out);
        }
        team.sync();
    }

    // Number of inliers of a floor, number of all cells, and reason of its refusal, or NONE.
    struct Verdict {
        int on, total, refused;
    };

    void write(int* out, FloorPlane plane, FloorAhead ahead, Verdict verdict) const {
        if (team.rank) return;
        const int start = ahead.turn ? ahead.start : 0;
        const int values[RESULTS] = {plane.pitch, plane.roll, plane.height,  start,
                                     ahead.turn,  verdict.on, verdict.total, verdict.refused};
        for (int k = 0; k < RESULTS; k++) out[k] = values[k];
    }

    FloorRamps ramps() const {
        return {{angles, settings, inner.part(0, counts[INNER]), keys, rows, places}};
    }

    void find(int number, int* out) const {
        const FloorCells sample = few.part(0, number);
        const FloorSearch search = {angles, settings, sample, counts + ENDS,
                                    slack,  weights,  keys,   lattice, ends, room};
        FloorPlane* all = (FloorPlane*)planes;
        FloorPlane* different = all + PLANES;
        const FloorPlane guess = has_prior ? prior : search.any_plane(team, different, votes);
        team.sync();
        if (team.rank == 0) all[0] = guess;
        const int count = 1 + search.near_planes(team, guess, has_prior, all + 1);
        search.score(team, all, count, votes);
        int best = 0, first = -1;
        for (int n = 0; n < count; n++) {
            if (votes[n] > votes[best]) best = n;
            if (is_near(all[n]) && (first < 0 || votes[n] > votes[first])) first = n;
        }
        if (first < 0) first = 0;
        FloorPlane plane = all[first];
        FloorAhead ahead;
        if (settings->ramps) {
            int others = 0;
            for (int n = -1; n < count; n++) {
                const FloorPlane one = all[n < 0 ? first : n];
                bool is_new = n < 0 || is_near(one);
                for (int k = 0; k < others; k++) is_new = is_new && !(different[k] == one);
                // All threads count the planes, but only the first thread writes them; the others
                // read them after a sync.
                if (is_new && team.rank == 0) different[others] = one;
                team.sync();
                others += is_new;
            }
            const int farthest = prior.height + settings->max_shift;
            const FloorOutlook outlook = {ramps(), has_prior, farthest, most_ramp};
            plane = outlook.run(team, different, others, ahead);
        }
        ThreadGroup everyone(team, sums);
        refine(everyone, plane, ahead);
        Verdict verdict = judge(everyone, plane, ahead);
        const long long least = (100LL * verdict.on + (long long)FAR_GAIN * verdict.total) * number;
        FloorPlane steep = plane;
        bool far = verdict.refused == FAR;
        if (has_prior && !is_near(all[best]) && 100LL * votes[best] * verdict.total > least) {
            steep = all[best];
            far = true;
        }
        if (far) {
            verdict.refused = FAR;
            FloorAhead ramp;
            const FloorPlane level = {prior.pitch, steep.roll, prior.height};
            if (has_prior && settings->ramps && is_near(level))
                ramp = ramps().crossing(level, steep);
            if (is_ahead(ramp)) {
                plane = level;
                ahead = ramp;
                verdict = judge(everyone, plane, ahead);
            }
        }
        write(out, plane, ahead, verdict);
    }

    bool is_ahead(FloorAhead ramp) const {
        return ramp.turn && ramp.start > 0 && ramp.start <= settings->farthest_ramp;
    }

    // Whether a plane is below the camera and near the prior; without a prior, whether it is below the
    // camera and the camera's tilt above it is usual.
    bool is_near(FloorPlane plane) const {
        if (!has_prior) return FloorSearch::is_usual(plane);
        const auto apart = [](long long a, long long b) { return a > b ? a - b : b - a; };
        const int turn = settings->max_turn;
        return plane.height > 0 && apart(plane.pitch, prior.pitch) <= turn &&
               apart(angles.wrapped(plane.roll - prior.roll), 0) <= turn &&
               apart(plane.height, prior.height) <= settings->max_shift;
    }

    // Refines the plane on all cells or, if there is a ramp or a step, on the cells before its start.
    // Refines a ramp on the cells beyond its start.
    void refine(ThreadGroup& group, FloorPlane& plane, FloorAhead& ahead) const {
        const FloorCells all = cells.part(0, counts[ALL]);
        const FloorRamps ramp = ramps();
        FloorPlane steep = plane;
        int before = all.count, beyond = 0;
        const bool is_split = ahead.turn || ahead.drop;
        if (ahead.turn) steep = ramp.steeper(plane, ahead);
        if (is_split) {
            const FloorDirection forward = angles.forward(plane);
            for (int i = team.rank; i < all.count; i += team.size) {
                const int x = all.x[i], y = all.y[i], z = all.z[i];
                const bool is_beyond = forward.along(x, y, z) >= ahead.start;
                const int n = team.atomic_count(counts + (is_beyond ? BEYOND : BEFORE));
                parts.put(is_beyond ? parts.count - 1 - n : n, x, y, z);
            }
            team.sync();
            before = counts[BEFORE];
            beyond = counts[BEYOND];
        }
        // There is a single call of `run`, so that it is inlined only once.
        for (int n = 0; n <= (ahead.turn != 0); n++) {
            const FloorPlane start = n ? steep : plane;
            const FloorRefine refined = {angles, settings, n ? steep : prior, n || has_prior, weights};
            const FloorCells some = is_split ? parts : cells;
            (n ? steep : plane) = refined.run(
                group, start,
                n ? some.part(some.count - beyond, beyond) : some.part(0, before), 0, 1, 5);
        }
        if (!ahead.turn) return;
        const FloorAhead between = ramp.crossing(plane, steep);
        if (is_ahead(between)) ahead = between;
    }

    // Counts the inliers of a floor, and decides whether it is refused.
    Verdict judge(ThreadGroup& group, FloorPlane plane, FloorAhead ahead) const {
        const FloorCells all = cells.part(0, counts[ALL]);
        const FloorDirection down = angles.down(plane), forward = angles.forward(plane);
        const FloorSlack fine(settings->fine, settings->noise, plane.height);
        const int slope = ahead.turn ? angles.slope(ahead.turn) : 0;
        const bool is_flat = !ahead.turn && !ahead.drop;
        const int table_depth = settings->table, step = settings->step;
        // Without a prior, a floor beyond a deep step may be the floor below a table.
        const bool may_be_table = !has_prior && ahead.drop > 0 &&
                                  plane.height + ahead.drop <= settings->over_table;
        int on = 0, low = 0, high = 0, dents = 0;
        for (int i = group.rank(); i < all.count; i += group.size()) {
            const int x = all.x[i], y = all.y[i], z = all.z[i];
            const int run = is_flat ? 0 : forward.along(x, y, z);
            const int rise = FloorRamps::rise(ahead.start, slope, run);
            const int up = rise - (run >= ahead.start ? ahead.drop : 0);
            const int deep = down.along(x, y, z) - plane.height + up, s = fine.at(z);
            on += (deep <= s) & (-deep <= s);
            const int most = FloorScore::BELOW * s;
            low += (deep > most + table_depth) |
                   (may_be_table & (deep - up > most + settings->deep));
            high += -deep > s + step;
            dents += 2 * deep > 3 * s;
        }
        long long sums[4] = {on, low, high, dents};
        group.sum(sums, 4);
        const long long total = all.count;
        // Without a prior, each cell in a dent (more than 1.5 tolerances below the plane) costs
        // BELOW_COST inliers, because a plane through a table has many such cells below it.
        const long long enough = sums[0] - (has_prior ? 0 : FloorScore::BELOW_COST * sums[3]);
        const int least = has_prior
            ? settings->min_share
            : FloorSearch::least_share(plane, settings->min_share_alone);
        const int share = has_prior ? UNDER : UNDER_ALONE;
        const int portion = has_prior ? UNDER_PART : UNDER_PART_ALONE;
        int refused = NONE;
        if (!is_near(plane))
            refused = FAR;
        else if (100 * sums[1] > share * total && portion * sums[1] > sums[0])
            refused = TABLE;
        else if (100 * sums[2] > OBSTACLE * total)
            refused = MOSTLY_OBSTACLE;
        else if (1000 * enough < least * total)
            refused = TOO_LITTLE;
        return {(int)sums[0], (int)total, refused};
    }
};

} }  // namespace jaxdet
