// Search for floor planes, near a guess or over all usual camera poses. Twin of
// jaxdet/reference/_floor_search.py, which documents the constants.
#pragma once
#include "floor_planes.h"
#include "vectors.h"
#include "warp.h"

namespace jaxdet { namespace {

// The cells that vote for planes, and scratch memory for their votes.
struct FloorSample {
    enum { RINGS = 7 };
    FloorAngles angles;
    const FloorSettings* settings;
    // The cells, sorted by ring, and the number of cells up to the end of each ring.
    FloorCells cells;
    const int* ring_ends;
    // `slack` has the tolerance of each cell [depth units]; `weights` has one word per cell for each
    // ThreadGroup; `keys` has FloorSearch::KEY_WORDS words; `votes` has the votes of all cells for each
    // plane of a lattice, bins + 1 words per direction; `counts` has the counts for FloorVotes::LANES
    // directions, or on CUDA `room` words of shared memory.
    int *slack, *weights;
    unsigned long long* keys;
    int *votes, *counts;
    int room;
};

// Hough transform: the cells up to each ring vote for planes on a lattice of pitch, roll and height. A
// direction is a pair of pitch and roll. For each direction a cell votes for a range of heights. The
// ends of the ranges are counted, and the votes are the prefix sums of the counts. On the CPU all cells
// are processed for a vector of directions at a time. On CUDA each lane of a warp handles one
// direction, the warps share the cells, and as many directions are counted at once as fit in shared
// memory.
struct FloorVotes : FloorSample {
    // Directions that a thread sums up together, their number, and the number of a warp's directions.
    typedef Vectors::Ints Lanes;
    enum { LANES = Vectors::INTS, GROUP = LANES * Warp::size };
    // A lattice has fewer than 2^BIN_BITS heights. `next` leaves out heights up to APART bins away.
    enum { APART = 12, BIN_BITS = 10, NOTHING = -0x7fffffff };
    // Lattice of planes: first pitch and first roll, and their spacing [angle steps]; number of pitches
    // and of rolls; lowest height [depth units]; number of heights. The spacing of heights is 2^bits
    // depth units.
    int pitch0, roll0, step, pitches, rolls, lowest, bins, bits;
    // Number of pitches and of heights at each end of the lattice that its near part excludes.
    int edge_pitches = 0, edge_bins = 0;
    // Number of rings whose votes are counted separately; the last one has all cells. Other rings up to
    // which there are fewer than `fewest` cells are skipped.
    int rings = 1, fewest = 0;

    // For each ring, the best key of the near part, with the votes of the cells up to the ring.
    unsigned long long* best() const { return keys; }
    // The best key of the complete lattice, with the votes of all cells.
    unsigned long long* whole() const { return keys + RINGS; }
    // The best key of each direction in the near part, with the votes of all cells.
    unsigned long long* of_direction() const { return keys + RINGS + 1; }

    int directions() const { return pitches * rolls; }

    // Plane of direction d and height bin `bin`.
    FloorPlane plane(int d, int bin) const {
        const int pitch = angles.clipped(pitch0 + d / rolls * step, FloorAngles::STEEPEST);
        return {pitch, roll0 + d % rolls * step, lowest + (bin << bits)};
    }
    FloorPlane plane(unsigned long long key) const {
        const int index = FloorKey::number(key);
        return plane(index / bins, index % bins);
    }
    FloorDirection direction(int d) const { return angles.down(plane(d, 0)); }

    // `FloorKey` of direction d and height bin `bin`.
    unsigned long long key(int votes, int d, int bin) const {
        return FloorKey::of(votes, d * bins + bin);
    }

    // `FloorKey` of direction d from `most`, which packs votes and bin as votes * 2^BIN_BITS - bin. So
    // it is larger for more votes and, among equal votes, for a lower bin.
    unsigned long long key(int most, int d) const {
        const int bin = -most & ((1 << BIN_BITS) - 1);
        return key((most + bin) >> BIN_BITS, d, bin);
    }

    // The near part has the directions first_near() to end_near() - 1.
    int first_near() const { return edge_pitches * rolls; }
    int end_near() const { return (pitches - edge_pitches) * rolls; }
    bool is_near(int d) const { return d >= first_near() && d < end_near(); }

    // Counts for the directions of one pass. `words[b * span + k]` is the count of direction k and bin
    // b. If counts are packed, the lower half of `words[n * span + k]` is that of bin 2 n, and the
    // upper half is that of bin 2 n + 1.
    struct Table {
        enum { MOST_PACKED = 10000 };  // maximum number of cells, so that counts are below 2^15
        int* words;
        int span;
        bool is_shared, is_packed;

        // Adds the counts of bin b to `sum`, for LANES directions from k on.
        void add(int k, int b, Lanes* sum) const {
            const Lanes word = *(const Lanes*)(words + (is_packed ? b >> 1 : b) * span + k);
            const Lanes high = (word + (1 << 15)) >> 16;
            *sum += !is_packed ? word : b & 1 ? high : word - high * (1 << 16);
        }
    };

    // Number of directions, padded to complete groups.
    int padded() const { return (directions() + GROUP - 1) / GROUP * GROUP; }
    // Whether the votes of all directions fit in shared memory.
    bool are_fast() const { return padded() * (bins + 1) <= room; }
    // `row_of` is the first vote of direction d; `bin_step` is the number of words from each vote of a
    // direction to the next. On the CPU the votes of LANES directions are adjacent in memory.
    int* row_of(int d) const {
        const int place = Warp::size > 1 ? d : d / LANES * LANES * (bins + 1) + d % LANES;
        return (are_fast() ? counts : votes) + place;
    }
    int bin_step() const { return Warp::size > 1 ? padded() : (int)LANES; }

#if defined(__CUDA_ARCH__)
    // Counts the ends of the ranges of heights that the cells `from` to `to` - 1 vote for. Each lane
    // handles one direction `down`, with index `k_of_lane` in the table.
    void count(const Warp& warp, const FloorDirection& down, int from, int to, const Table& table,
               int k_of_lane) const {
        int* const ends = table.words + k_of_lane;
        const int step = table.span, low = lowest, shift = bits, last = bins;
        const bool is_packed = table.is_packed, is_shared = table.is_shared;
        for (int start = from; start < to; start += Warp::size) {
            const int i = start + warp.lane < to ? start + warp.lane : to - 1;
            const int x = cells.x[i], y = cells.y[i], z = cells.z[i], width = slack[i];
            const int n = to - start < Warp::size ? to - start : Warp::size;
#pragma unroll 4
            for (int k = 0; k < n; k++) {
                const int s = warp.broadcast(width, k);
                const int height = down.along(warp.broadcast(x, k), warp.broadcast(y, k),
                                              warp.broadcast(z, k)) - low;
                const int begin = -((s - height) >> shift), end = ((height + s) >> shift) + 1;
                const int bin[2] = {min(max(begin, 0), last), min(max(end, 0), last)};
                const int worth[2] = {1 + FloorScore::BELOW_COST, -1};
#pragma unroll
                for (int m = 0; m < 2; m++)
                    if (is_packed)
                        warp.add_shared(ends + (bin[m] >> 1) * step, worth[m] << (bin[m] % 2 * 16));
                    else if (is_shared)
                        warp.add_shared(ends + bin[m] * step, worth[m]);
                    else
                        atomicAdd(ends + bin[m] * step, worth[m]);
            }
        }
    }

    void count(const Team& team, int first, int from, int to, const Table& table) const {
        const Warp warp(team);
        const int groups = table.span / Warp::size, share = to - from;
        for (int unit = warp.index; unit < groups * warp.count; unit += warp.count) {
            // Each warp takes a different part of the cells for each group, so that the load is
            // balanced.
            const int group = unit / warp.count, part = (warp.index + group) % warp.count;
            const int k = group * Warp::size + warp.lane;
            count(warp, direction(first + k), from + share * part / warp.count,
                  from + share * (part + 1) / warp.count, table, k);
        }
        team.sync();
    }
#else
    // Writes the index of each lane's height bin in the counts, without the index of the lane; bins are
    // clipped to 0 .. bins.
    void place(const Lanes& bin, int* out) const {
        const Lanes none = {}, last = none + bins;
        const Lanes at = (bin < none ? none : bin > last ? last : bin) * (int)LANES;
        __builtin_memcpy(out, &at, sizeof at);
    }

    // Counts the ends of the ranges of heights that the cells `from` to `to` - 1 vote for, for LANES
    // directions from `first` on.
    void count(const Team&, int first, int from, int to, const Table& table) const {
        Lanes dx, dy, dz;
        for (int k = 0; k < LANES; k++) {
            const FloorDirection down = direction(first + k);
            dx[k] = down.x;
            dy[k] = down.y;
            dz[k] = down.z;
        }
        const int half = 1 << (FloorDirection::DOWN_BITS - 1), shift = bits;
        int* const ends = table.words;
        const int left = directions() - first, used = left < LANES ? left : (int)LANES;
        int begin[LANES], end[LANES];
        for (int i = from; i < to; i++) {
            const int s = slack[i];
            const Lanes sum = dx * cells.x[i] + dy * cells.y[i] + dz * cells.z[i] + half;
            const Lanes height = (sum >> (int)FloorDirection::DOWN_BITS) - lowest;
            place(-((s - height) >> shift), begin);
            place(((height + s) >> shift) + 1, end);
            for (int k = 0; k < used; k++) {
                ends[begin[k] + k] += 1 + FloorScore::BELOW_COST;
                ends[end[k] + k]--;
            }
        }
    }
#endif

    // Adds up the counts of `cells` cells to votes, for LANES directions from k on. Sets `nearer` to
    // the best bin of the near part and `all` to the best of all bins, each with its votes, packed as
    // in `key`. Writes the votes to `out` unless it is null.
    void sum_up(const Table& table, int k, int cells, int* out, Lanes& nearer, Lanes& all) const {
        const int step = bin_step(), from = edge_bins, to = bins - edge_bins;
        Lanes sum = Lanes{} - FloorScore::BELOW_COST * cells;
        Lanes most = Lanes{} + (int)NOTHING, highest = most;
        for (int b = 0; b < bins; b++) {
            table.add(k, b, &sum);
            if (out) *(Lanes*)(out + b * step) = sum;
            const Lanes here = sum * (1 << BIN_BITS) - b;
            if (b >= from && b < to) most = here > most ? here : most;
            highest = here > highest ? here : highest;
        }
        nearer = most;
        all = highest;
    }

    // Computes the votes for the `table.span` directions from `first` on, and updates the best keys.
    void run(const Team& team, int first, const Table& table) const {
        const Warp warp(team);
        const int span = table.span, end_of_all = directions();
        const int size = span * (table.is_packed ? bins / 2 + 1 : bins + 1);
        for (int k = team.rank; k < size; k += team.size) table.words[k] = 0;
        team.sync();
        int done = 0;
        for (int n = 0; n < rings; n++) {
            const bool is_last = n == rings - 1;
            const bool some_near = first < end_near() && first + span > first_near();
            if (!is_last && (ring_ends[n] < fewest || !some_near)) continue;
            const int end = is_last ? cells.count : ring_ends[n];
            count(team, first, done, end, table);
            for (int k = team.rank * LANES; k < span; k += team.size * LANES) {
                Lanes most, highest;
                sum_up(table, k, end, is_last ? row_of(first + k) : nullptr, most, highest);
                unsigned long long nearer = ~0ull, all = ~0ull;
                for (int lane = 0; lane < LANES; lane++) {
                    const int d = first + k + lane;
                    if (d >= end_of_all) break;
                    const unsigned long long own =
                        is_near(d) ? key(((const int*)&most)[lane], d) : ~0ull;
                    const unsigned long long any = key(((const int*)&highest)[lane], d);
                    nearer = own < nearer ? own : nearer;
                    all = any < all ? any : all;
                    if (is_last) of_direction()[d] = own;
                }
                nearer = warp.min(nearer);
                if (warp.lane == 0) team.atomic_min(best() + n, nearer);
                if (!is_last) continue;
                all = warp.min(all);
                if (warp.lane == 0) team.atomic_min(whole(), all);
            }
            team.sync();
            done = end;
        }
    }

    // Computes the votes for all directions, and the best keys.
    void run(const Team& team) const {
        for (int n = team.rank; n < rings; n += team.size) best()[n] = ~0ull;
        if (team.rank == 0) *whole() = ~0ull;
        team.sync();
        const int all = padded(), on_cuda = Warp::size > 1;
        const bool is_packed = on_cuda && !are_fast() && cells.count <= Table::MOST_PACKED;
        // Number of directions that fit in shared memory; if it is 0, all are counted at once in `votes`.
        const int fits = room / (is_packed ? bins / 2 + 1 : bins + 1) / GROUP * GROUP;
        const int most = on_cuda ? fits : (int)LANES, span = most ? most : all;
        for (int first = 0; first < all; first += span)
            run(team, first, {most ? counts : votes,
                              on_cuda && all - first < span ? all - first : span, most > 0,
                              is_packed && most});
        team.sync();
    }

    // Replaces the last key of `best` by that of the next best plane in the near part, with the votes
    // of all cells. Planes similar to the previous ones are left out: their votes are overwritten.
    void next(const Team& team) const {
        unsigned long long* const last = best() + rings - 1;
        const int index = FloorKey::number(*last), d = index / bins, h = index - d * bins;
        const int p = d / rolls, r = d % rolls;
        const Warp warp(team);
        team.sync();
        if (team.rank == 0) *last = ~0ull;
        for (int k = warp.index; k < 9; k += warp.count) {
            const int pitch = p + k / 3 - 1, roll = r + k % 3 - 1, other = pitch * rolls + roll;
            if (pitch < 0 || pitch >= pitches || roll < 0 || roll >= rolls) continue;
            int* row = row_of(other);
            const int from = h - APART > 0 ? h - APART : 0, step = bin_step();
            const int to = h + APART + 1 < bins ? h + APART + 1 : bins;
            int most = -0x7fffffff - 1, bin = bins;
            for (int b = warp.lane; b < bins; b += warp.size) {
                if (b >= from && b < to) row[b * step] = -0x7fffffff - 1;
                const int here = row[b * step];
                if (b < edge_bins || b >= bins - edge_bins || (here <= most && bin < bins)) continue;
                most = here;
                bin = b;
            }
            const unsigned long long found =
                warp.min(bin < bins ? key(most, other, bin) : ~0ull);
            if (is_near(other) && warp.lane == 0) of_direction()[other] = found;
        }
        team.sync();
        unsigned long long left = ~0ull;
        for (int k = team.rank; k < directions(); k += team.size)
            left = of_direction()[k] < left ? of_direction()[k] : left;
        left = warp.min(left);
        if (warp.lane == 0) team.atomic_min(last, left);
        team.sync();
    }
};

struct FloorSearch : FloorSample {
    enum {
        MIN_SHARE = 3,
        NEAR_DEG = 4,
        STEEP_DEG = 8,
        PITCH_LEAST = -15,
        PITCH_MOST = 72,
        ROLL_MOST = 30,
        ROLLED_DEG = 40,
        FILLS_DEG = 35,
        FILLS = 12,
        STEP_DEG = 3,
        WINNERS = 6,
        NEAR_PLANES = 9,
        ANY_PLANES = RINGS - 1 + WINNERS,
        MOST_DIRECTIONS = 30 * 21,
        KEY_WORDS = 2 * (RINGS + 1 + MOST_DIRECTIONS)
    };

    // Whether a plane is below the camera, with a tilt that is usual for a camera on a robot or in a hand.
    static bool is_usual(FloorPlane plane) {
        const int one = FloorAngles::ANGLES, roll = ROLLED_DEG * one;
        return plane.pitch >= PITCH_LEAST * one && plane.pitch <= PITCH_MOST * one &&
               plane.roll <= roll && -plane.roll <= roll && plane.height > 0;
    }

    // Minimum inlier fraction of a plane [per mille]. It is `least` for a level camera, and increases
    // with pitch beyond FILLS_DEG, because a camera that is pitched more sees more floor.
    static int least_share(FloorPlane plane, int least) {
        const int beyond = plane.pitch - FILLS_DEG * FloorAngles::ANGLES;
        return least + (beyond > 0 ? FILLS * beyond / FloorAngles::ANGLES : 0);
    }

    // Number of heights of a lattice over a range of `span` depth units.
    static int bins_of(const FloorSettings* settings, int span) {
        return (span >> settings->bin_bits) + 1;
    }

    // Number of heights of the largest lattice, plus one.
    static int most_bins(const FloorSettings* settings) {
        const int near = 2 * settings->span, wide = settings->highest - settings->lowest;
        return bins_of(settings, near > wide ? near : wide) + 1;
    }

    // Number of words for the votes of the largest lattice. Directions are padded to complete warps,
    // and each has one word more than there are heights.
    static int lattice_words(const FloorSettings* settings) {
        return (MOST_DIRECTIONS + 31) / 32 * 32 * most_bins(settings);
    }

    // Writes the tolerance of each cell for votes to `slack`. The tolerance includes the spacing of
    // directions, through `per_z`, and is the same for all heights of the camera.
    void coarse(const Team& team, int per_z) const {
        const int noise = settings->noise;
        const FloorSlack rough({settings->rough.base, per_z}, noise, 0);
        for (int i = team.rank; i < cells.count; i += team.size) {
            const long long z = cells.z[i];
            slack[i] = rough.at(cells.z[i]) + (int)((z * z * noise) >> FloorSlack::BITS);
        }
        team.sync();
    }

    // Lattice of planes around `middle`: up to `turn` degrees of pitch and `roll` degrees of roll on
    // each side, one degree apart.
    FloorVotes around(FloorPlane middle, int turn, int roll) const {
        const int one = FloorAngles::ANGLES, span = settings->span;
        return {*this, middle.pitch - turn * one, middle.roll - roll * one, one, 2 * turn + 1,
                2 * roll + 1, middle.height - span, bins_of(settings, 2 * span), settings->bin_bits};
    }

    // Counts the votes for each plane. Each warp takes a part of the cells, so that the load is
    // balanced for any number of planes.
    void score(const Team& team, const FloorPlane* planes, int count, int* votes) const {
        for (int n = team.rank; n < count; n += team.size) votes[n] = 0;
        team.sync();
        const Warp warp(team);
        const int *xs = cells.x, *ys = cells.y, *zs = cells.z, parts = warp.count;
        for (int unit = warp.index; unit < count * parts; unit += warp.count) {
            const int n = unit / parts, part = unit - n * parts;
            const FloorPlane plane = planes[n];
            const FloorDirection down = angles.down(plane);
            const FloorSlack fine(settings->fine, settings->noise, plane.height);
            const int height = plane.height, to = cells.count * (part + 1) / parts;
            int sum = 0;
            for (int i = cells.count * part / parts + warp.lane; i < to; i += Warp::size)
                sum += FloorScore::of(down.along(xs[i], ys[i], zs[i]) - height, fine.at(zs[i]));
            sum = warp.sum(sum);
            if (warp.lane == 0) team.atomic_add(votes + n, sum);
        }
        team.sync();
    }

    // Finds the best plane of the near part for the cells up to each ring. Writes the planes to
    // `planes` and the numbers of these cells to `ends`; returns the number of planes.
    int best_of_rings(const Team& team, FloorVotes& lattice, FloorPlane* planes, int* ends) const {
        lattice.rings = RINGS;
        lattice.fewest = (MIN_SHARE * cells.count + 99) / 100;
        lattice.run(team);
        int count = 0;
        for (int n = 0; n < RINGS; n++) {
            if (ring_ends[n] < lattice.fewest) continue;
            if (n > 0 && ring_ends[n] == ring_ends[n - 1]) continue;  // the same cells and plane
            ends[count] = ring_ends[n];
            if (team.rank == 0) planes[count] = lattice.plane(lattice.best()[n]);
            count++;
        }
        return count;
    }

    // Finds up to NEAR_PLANES planes near a guess, which may be the prior; returns their number.
    int near_planes(const Team& team, FloorPlane guess, bool is_prior, FloorPlane* planes) const {
        coarse(team, settings->rough.per_z);
        FloorVotes lattice = around(guess, STEEP_DEG, NEAR_DEG);
        lattice.edge_pitches = STEEP_DEG - NEAR_DEG;
        lattice.edge_bins = settings->edge;
        int ends[NEAR_PLANES];
        int count = best_of_rings(team, lattice, planes, ends);
        lattice.next(team);
        // `any` is the best plane of the complete lattice; it is omitted if the near
        // part has the same best plane.
        const FloorPlane any = lattice.plane(*lattice.whole());
        const bool is_new = !(any == planes[count - 1]);
        if (team.rank == 0) {
            planes[count] = lattice.plane(lattice.best()[RINGS - 1]);
            if (is_new) planes[count + 1] = any;
        }
        ends[count] = ends[count + 1] = cells.count;
        count += 1 + is_new;
        team.sync();
        refine(team, planes, count, ends, guess, is_prior, 1);
        return count;
    }

    // Refines plane n on the first `ends[n]` cells, with at most `sharp` rounds with the sharp tolerance;
    // on CUDA each warp refines one plane at a time. Ends in a sync.
    void refine(const Team& team, FloorPlane* planes, int count, const int* ends, FloorPlane prior,
                bool has_prior, int sharp) const {
        ThreadGroup group(team);
        const FloorRefine refined = {angles, settings, prior, has_prior,
                                     weights + group.index() * cells.count};
        for (int n = group.index(); n < count; n += group.count()) {
            const FloorPlane plane = refined.run(group, planes[n], cells.part(0, ends[n]), 2, 2, sharp);
            if (group.rank() == 0) planes[n] = plane;
        }
        team.sync();
    }

    // Finds the best floor without a prior, for any usual pose of the camera; `planes` and `scores`
    // have room for ANY_PLANES elements each.
    FloorPlane any_plane(const Team& team, FloorPlane* planes, int* scores) const {
        const int one = FloorAngles::ANGLES;
        FloorVotes wide = {*this, PITCH_LEAST * one, -ROLL_MOST * one, STEP_DEG * one,
                           (PITCH_MOST - PITCH_LEAST) / STEP_DEG + 1, 2 * ROLL_MOST / STEP_DEG + 1,
                           settings->lowest,
                           bins_of(settings, settings->highest - settings->lowest), settings->bin_bits};
        coarse(team, settings->wide_per_z);
        int ends[ANY_PLANES];
        int count = best_of_rings(team, wide, planes, ends);
        for (int n = 1; n < WINNERS; n++) {
            wide.next(team);
            if (team.rank == 0) planes[count] = wide.plane(wide.best()[RINGS - 1]);
            count++;
        }
        team.sync();
        coarse(team, settings->rough.per_z);
        for (int n = 0; n < count; n++) {
            const FloorVotes close = around(planes[n], 1, 1);
            close.run(team);
            if (team.rank == 0) planes[n] = close.plane(close.best()[0]);
            team.sync();
        }
        for (int n = 0; n < count; n++) ends[n] = cells.count;
        refine(team, planes, count, ends, {0, 0, 0}, false, 0);
        score(team, planes, count, scores);
        const int least = settings->min_share_alone;
        int best = 0;
        long long most = 0;
        for (int n = 0; n < count; n++) {
            const long long share = least_share(planes[n], least);
            const long long more = 1000LL * scores[n] - share * cells.count;
            const bool usual = is_usual(planes[n]), best_is = is_usual(planes[best]);
            if (!n || (usual == best_is ? more > most : usual)) {
                best = n;
                most = more;
            }
        }
        return planes[best];
    }
};

} }  // namespace jaxdet
