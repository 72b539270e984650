// Detection of a ramp ahead of a plane, by votes on the profile of the floor. Twin of
// jaxdet/reference/_floor_ramp.py, which documents the constants.
#pragma once
#include "floor_profile.h"

namespace jaxdet { namespace {

struct FloorRamps : FloorProfile {
    enum {
        LEAST_TURN = 3 * FloorAngles::ANGLES,
        MOST_TURN = 12 * FloorAngles::ANGLES,
        TURN_STEP = FloorAngles::ANGLES / 2,
        TURNS = (MOST_TURN - LEAST_TURN) / TURN_STEP + 1,
        STARTS = 16,
        AROUND = 4,
        FINE = 2 * AROUND + 1,
        FINE_TURN = FloorAngles::ANGLES / 4,
        MIN_SHARE = 40,
        // `limit` groups ramps by turn, in SECTORS sectors of three degrees, and by start. ABREAST
        // starts are processed together.
        SECTOR = 3 * FloorAngles::ANGLES,
        SECTORS = 2 * (MOST_TURN - LEAST_TURN) / SECTOR,
        ABREAST = Warp::size > 1 ? 1 : STARTS
    };

    // Upper bound of the votes of any ramp by the cells of this and all farther distance bins, for each
    // distance bin; computed by `limits`.
    int* most() const { return row(2); }
    // Number of inliers of the plane, for each distance bin; computed by `limits`.
    int* own() const { return row(5); }
    // Results of `is_seen` per distance bin: number of cells that are inliers of the ramp but not of
    // the plane; number of cells that are not clearly above either, -1 where ramp and plane do not
    // differ.
    int* ramp_cells() const { return row(5); }
    int* all_cells() const { return row(6); }
    // Upper bound of the votes in the distance bin of each sorted cell; see `limits`.
    int* worth() const { return places; }

    // Height of a ramp above the plane at the distance `run`; lengths are in depth units. Distances have
    // 19 bits and slopes 12, so that their product fits in 32 bits.
    static int rise(int start, int slope, int run) {
        const int product = slope * (run > start ? run - start : 0);
        return (product + (1 << (FloorAngles::SLOPE_BITS - 1))) >> FloorAngles::SLOPE_BITS;
    }

    // Computes, for each distance bin, the inliers of the plane, the votes for a flat floor and an upper
    // bound of the votes for any ramp. For each cell it also computes an upper bound of the votes, in
    // the cell's distance bin, for a ramp whose highest inlier there is this cell. Let s be the tolerance
    // and p the height of a ramp in the bin: its inliers are from p - s to p + s, and cells below p - 4 s
    // cost votes. If the highest inlier is at height h, p is at least h - s, so no inlier is below
    // h - 2 s, and all cells below h - 5 s cost votes.
    void limits(const Team& team, const int* slack) const {
        const int bits = settings->rise_bits, each = FloorScore::BELOW_COST;
        const int *heights = this->heights(), *at = places + 3 * cells.count;
        for (int k = team.rank; k <= runs(); k += team.size) most()[k] = flat()[k] = 0;
        team.sync();
        for (int k = team.rank; k < runs(); k += team.size) {
            int low;
            own()[k] = on(k, 0, slack[k], low);
            flat()[k] = own()[k] - each * low;
        }
        // The CPU takes up to CELLS cells of a distance bin at a time, and ignores the counts of heights
        // that belong to the next bin.
        enum { CELLS = Warp::size > 1 ? 1 : 8 };
        for (int i = team.rank, n = 1; i < begin()[runs()]; i += n * team.size) {
            const int k = at[i], s = slack[k];
            const int width = 2 * s >> bits, deep = (FloorScore::BELOW + 1) * s >> bits;
            Ranges<CELLS> ranges;
            for (int w = 0; w < CELLS; w++) {
                const int h = heights[i + w];
                ranges.over[w] = h + 1, ranges.least[w] = h - width, ranges.deep[w] = h - deep;
            }
            int here[CELLS] = {}, low[CELLS] = {};
            count<CELLS>(k, ranges, here, low);
            n = begin()[k + 1] - i < CELLS ? begin()[k + 1] - i : (int)CELLS;
            for (int w = 0; w < n; w++) {
                worth()[i + w] = here[w] - each * low[w];
                team.atomic_max(most() + k, worth()[i + w]);
            }
        }
        team.sync();
        // Replaces the flat votes by their prefix sums, and the upper bounds by their suffix sums.
        const Warp warp(team);
        if (warp.index == 0) warp.exclusive_sum(flat(), runs());
        if (warp.index == 1 % warp.count) {
            const int all = warp.exclusive_sum(most(), runs());
            for (int k = warp.lane; k <= runs(); k += warp.size) most()[k] = all - most()[k];
        }
        team.sync();
    }

    // Raises `found` to an upper bound of the votes of any ramp: the largest bound of all groups of
    // ramps with similar start and turn. `limits` must have run with the fine tolerance.
    void limit(const Team& team, int* found) const {
        const int *heights = this->heights(), middle_rise = half();
        const int bits = settings->rise_bits;
        for (int first = team.rank * ABREAST; first < STARTS * SECTORS; first += team.size * ABREAST) {
            const int sector = first / STARTS;
            const int turn = sector < SECTORS / 2 ? -MOST_TURN + sector * SECTOR
                                                  : LEAST_TURN + (sector - SECTORS / 2) * SECTOR;
            const int low_slope = angles.slope(turn), high_slope = angles.slope(turn + SECTOR);
            const bool uphill = turn > 0;
            int nearest[ABREAST], farthest[ABREAST], votes[ABREAST];
            for (int w = 0; w < ABREAST; w++) {
                nearest[w] = begins(first % STARTS + w);
                farthest[w] = begins(first % STARTS + w + 1);
                votes[w] = 0;
            }
            for (int k = 0; k < runs(); k++) {
                const int from = begin()[k], to = begin()[k + 1], run = middle(k), s = fine()[k];
                if (from == to) continue;
                const int level = flat()[k + 1] - flat()[k];
                int lowest[ABREAST], highest[ABREAST], most[ABREAST];
                for (int w = 0; w < ABREAST; w++) {
                    const int low = rise(uphill ? farthest[w] : nearest[w], low_slope, run);
                    const int high = rise(uphill ? nearest[w] : farthest[w], high_slope, run);
                    lowest[w] = ((low - s) >> bits) + middle_rise;
                    highest[w] = ((high + s) >> bits) + middle_rise;
                    most[w] = 0;
                }
                for (int i = from; i < to; i++) {
                    const int h = heights[i], own = worth()[i];
                    for (int w = 0; w < ABREAST; w++) {
                        const bool counts = (h >= lowest[w]) & (h < highest[w]) & (own > most[w]);
                        most[w] = counts ? own : most[w];
                    }
                }
                for (int w = 0; w < ABREAST; w++) votes[w] += run > nearest[w] ? most[w] : level;
            }
            for (int w = 0; w < ABREAST; w++) team.atomic_max(found, votes[w]);
        }
    }

    // Smallest start of the ramps in group `i` of `limit` [depth units]; the largest is begins(i + 1).
    // The groups cover the starts of the coarse lattice and of all fine lattices.
    int begins(int i) const {
        const int around = AROUND * settings->start_step;
        const int* starts = settings->starts;
        return i < STARTS ? starts[i] - around : starts[STARTS - 1] + around;
    }

    // Candidate ramps form a lattice of starts and turns: if `around` is a ramp, the fine lattice around
    // it, otherwise the coarse lattice of all ramps.
    static int num_starts(FloorAhead around) { return around.turn ? (int)FINE : (int)STARTS; }
    static int num_turns(FloorAhead around) { return around.turn ? (int)FINE : 2 * TURNS; }

    // Start of the ramps with index i [depth units], and turn of the ramps with index j [angle steps].
    int start_of(FloorAhead around, int i) const {
        return around.turn ? around.start + (i - AROUND) * settings->start_step : settings->starts[i];
    }
    static int turn_of(FloorAhead around, int j) {
        if (!around.turn)
            return j * TURN_STEP + (j < TURNS ? -MOST_TURN : LEAST_TURN - TURNS * TURN_STEP);
        const bool downhill = around.turn < 0;
        const int size = (downhill ? -around.turn : around.turn) + (j - AROUND) * FINE_TURN;
        const int turn = size < LEAST_TURN ? LEAST_TURN : size > MOST_TURN ? MOST_TURN : size;
        return downhill ? -turn : turn;
    }

    // Lowers `key` to the `FloorKey` of the first ramp of a lattice with the most votes, if it has at
    // least `least` votes. `limits` must have run with the same tolerance. ABREAST ramps with the same
    // turn are tried together; ramps that cannot have as many votes as the best one so far are skipped.
    void best(const Team& team, FloorAhead around, const int* slack, int least) const {
        const int starts = num_starts(around), turns = num_turns(around);
        const int n = runs(), *const rest = most();
        int most_votes = least;
        for (int group = (starts + ABREAST - 1) / ABREAST * turns - 1 - team.rank; group >= 0;
             group -= team.size) {
            const int first = group / turns * ABREAST, turn = group % turns;
            const int slope = angles.slope(turn_of(around, turn));
            // Start, number and votes of each ramp. Starts increase; surplus entries repeat the last one.
            int start[ABREAST], number[ABREAST], votes[ABREAST], highest;
            for (int w = 0; w < ABREAST; w++) {
                const int i = first + w < starts ? first + w : starts - 1;
                start[w] = start_of(around, i);
                number[w] = i * turns + turn;
            }
            int k = first_beyond(start[0]);
            for (int w = 0; w < ABREAST; w++) votes[w] = highest = flat()[k];
#if defined(__CUDA_ARCH__)
            const int others = FloorKey::votes(*(volatile unsigned long long*)key);
            if (others > most_votes) most_votes = others;
#endif
            for (; k < n && highest + rest[k] >= most_votes; k++) {
                if (begin()[k] == begin()[k + 1]) continue;
                int up[ABREAST], on[ABREAST] = {}, low[ABREAST] = {};
                const int run = middle(k);
                for (int w = 0; w < ABREAST; w++) up[w] = rise(start[w], slope, run);
                count<ABREAST>(k, up, slack[k], on, low);
                highest = votes[0];
                for (int w = 0; w < ABREAST; w++) {
                    votes[w] += on[w] - FloorScore::BELOW_COST * low[w];
                    highest = votes[w] > highest ? votes[w] : highest;
                }
            }
            for (int w = 0; k == n && w < ABREAST; w++) {
                if (votes[w] < most_votes) continue;
                most_votes = votes[w];
                team.atomic_min(key, FloorKey::of(votes[w], number[w]));
            }
        }
        team.sync();
    }

    // First distance bin whose centre lies beyond `start` [depth units].
    int first_beyond(int start) const {
        const int k = start < 0 ? 0 : start >> settings->run_bits;
        return k < runs() ? k + (middle(k) <= start) : runs();
    }

    // Finds the ramp with the most votes above a plane, and its votes. `sort` must have run for this
    // plane. Returns false if the ramp has fewer than `least` votes or is not visible.
    bool ramp(const Team& team, int least, FloorAhead& found, int& votes) const {
        found = {};
        for (int pass = 0; pass < 2; pass++) {
            const int *slack = pass ? fine() : coarse(), turns = num_turns(found);
            limits(team, slack);
            if (team.rank == 0) *key = ~0ull;
            team.sync();
            best(team, found, slack, pass ? least : -0x7fffffff);
            if (*key == ~0ull) return false;
            const int m = FloorKey::number(*key);
            votes = FloorKey::votes(*key);
            found = {start_of(found, m / turns), turn_of(found, m % turns)};
        }
        return is_seen(team, found);
    }

    // Whether the ramp is visible close to its start and over some distance, see `extend`. At distances
    // at which ramp and plane differ, at least MIN_SHARE percent of the cells that are not clearly above
    // the floor must be inliers of the ramp but not of the plane.
    bool is_seen(const Team& team, FloorAhead ramp) const {
        const int slope = angles.slope(ramp.turn);
        const bool uphill = ramp.turn > 0;
        for (int k = team.rank; k < runs(); k += team.size) {
            const int up = rise(ramp.start, slope, middle(k)), s = fine()[k];
            const bool distinct = up > s || -up > s;
            // If the tolerances of ramp and plane overlap, a cell belongs to the plane.
            int low = up - s, high = up + s;
            if (uphill && low < s) low = s;
            if (!uphill && high > -s) high = -s;
            ramp_cells()[k] = distinct ? under(k, high) - under(k, low) : 0;
            all_cells()[k] = distinct ? under(k, (up > 0 ? up : 0) + FloorScore::BELOW * s) : -1;
        }
        team.sync();
        int total = 0, all = 0, begins = -1;
        for (int k = 0; k < runs(); k++) {
            total += ramp_cells()[k];
            if (all_cells()[k] < 0) continue;
            all += all_cells()[k];
            if (begins < 0) begins = k;
        }
        if (100LL * total < (long long)MIN_SHARE * all || !total) return false;
        int first;
        const bool extends = extend(ramp_cells(), first);
        return extends && middle(first) < middle(begins) + settings->ramp_near;
    }

    // Ramp that begins where two planes cross and continues as the plane `steep`; no ramp if the angle
    // between the planes is not in the range of turns.
    FloorAhead crossing(FloorPlane level, FloorPlane steep) const {
        const int turn = steep.pitch - level.pitch, size = turn < 0 ? -turn : turn;
        if (size < LEAST_TURN || size > MOST_TURN) return {};
        const long long one = 1 << FloorAngles::SINE_BITS;
        const long long over = angles.quotient(steep.height * one, angles.cosine(turn)) - level.height;
        const long long rise = over * (1 << FloorAngles::SLOPE_BITS);
        const int slope = angles.slope(turn);
        const int sign = slope < 0 ? -1 : 1;
        return {angles.clipped(angles.quotient(sign * rise, sign * slope), 1 << 30), turn};
    }

    // Plane in which a ramp lies, with pitch limited to STEEPEST; the inverse of `crossing`.
    FloorPlane steeper(FloorPlane level, FloorAhead ramp) const {
        const long long up = (long long)ramp.start * angles.slope(ramp.turn);
        const long long height = level.height + (up >> FloorAngles::SLOPE_BITS);
        return {angles.clipped(level.pitch + ramp.turn, FloorAngles::STEEPEST), level.roll,
                (int)(height * angles.cosine(ramp.turn) >> FloorAngles::SINE_BITS)};
    }
};

} }  // namespace jaxdet
