// Shape of the floor ahead of its plane: flat, a ramp, or a step down or up. Twin of
// jaxdet/reference/_floor_ahead.py and jaxdet/reference/_floor_step.py, which document the constants.
#pragma once
#include "floor_ramp.h"

namespace jaxdet { namespace {

struct FloorOutlook : FloorRamps {
    enum { MIN_GAIN = 5, OVER_RAMP = 2, ALIKE = 3 };
    enum { DROPS = 28, RISES = 10, STEPS = DROPS + RISES, OWN = 4 };
    // Number of candidate steps that are tried together: all of them on the CPU.
    enum { TOGETHER = Warp::size > 1 ? 1 : STEPS };
    // `has_prior` is whether there is a prior; if so, `farthest` is the maximum height of the camera above
    // the floor [depth units].
    bool has_prior;
    int farthest;
    // Scratch, one word per plane: upper bound of the votes of a ramp ahead of the plane.
    int* most_ramp;

    // Chooses among distinct planes, each alone or with a ramp or a step ahead of it. If a plane with a
    // ramp or a step has clearly more votes than any plane alone, returns this plane, and writes the
    // ramp or step to `out`. Otherwise returns the first plane, and `out` has no ramp and no step.
    FloorPlane run(const Team& team, const FloorPlane* planes, int count, FloorAhead& out) const {
        const int none = -0x7fffffff;
        int most_alone = none, best_plane = 0, best_votes = none;
        unsigned tried = 0;
        out = {};
        for (int n = 0; n < count; n++) {
            if (team.rank == 0) most_ramp[n] = none;
            sort(team, planes[n]);
            limits(team, fine());
            const int alone = flat()[runs()];
            most_alone = alone > most_alone ? alone : most_alone;
            limit(team, most_ramp + n);
            team.sync();
            bool is_new = true;
            for (int k = 0; k < n; k++)
                if (tried >> k & 1) is_new = is_new && !are_alike(planes[n], planes[k]);
            if (!is_new) continue;
            tried |= 1u << n;
            FloorAhead found;
            int votes;
            const int deeper = has_prior ? farthest - planes[n].height : 0;
            if (!step(team, best_votes + 1, deeper, found, votes)) continue;
            best_votes = votes;
            best_plane = n;
            out = found;
        }
        const int gain = most_alone > 0 ? MIN_GAIN : 0;
        const long long least = (100LL + gain) * most_alone;
        const int needed = (int)angles.quotient(least, 100) + 1;
        if (best_votes < needed) {
            best_votes = needed - 1;
            best_plane = 0;
            out = {};
        } else {
            // The number of votes from which a ramp is preferred to the step.
            const int percent = 100 + OVER_RAMP, votes = best_votes;
            const int enough = votes > 0 ? (100 * votes + percent - 1) / percent : votes;
            best_votes = (enough > needed ? enough : needed) - 1;
        }
        int sorted = count - 1;
        for (int n = 0; n < count; n++) {
            if (most_ramp[n] <= best_votes) continue;
            if (n != sorted) sort(team, planes[n]);
            sorted = n;
            FloorAhead found;
            int votes;
            if (ramp(team, best_votes + 1, found, votes)) {
                best_votes = votes;
                best_plane = n;
                out = found;
            }
            team.sync();
        }
        return planes[best_plane];
    }

    // Whether two planes are too similar to try steps with both.
    bool are_alike(FloorPlane a, FloorPlane b) const {
        const auto differ = [](int a, int b, int most) { return a - b > most || b - a > most; };
        return !differ(a.pitch, b.pitch, ALIKE) && !differ(angles.wrapped(a.roll - b.roll), 0, ALIKE) &&
               !differ(a.height, b.height, settings->alike);
    }

    // Number of inliers of the floor beyond the step, for each distance bin.
    int* others() const { return row(6); }

    // Drop of the floor at candidate step `i` [depth units]; the steps down come first.
    int drop(int i) const {
        const int each = settings->drop_spacing;
        return i < DROPS ? (i + 1) * each : -(i - DROPS + 1) * each;
    }

    // Finds the step with the most votes, the first of several with equal votes, and its number of
    // votes. Returns false if it has fewer than `least` votes, or if the floor beyond the step is not
    // visible over some distance. A step down must be deeper than `deeper` [depth units]. `sort` and
    // `limits` must have run for this plane, with the fine tolerance.
    bool step(const Team& team, int least, int deeper, FloorAhead& found, int& votes) const {
        const int n = runs(), each = FloorScore::BELOW_COST;
        const Warp warp(team);
        if (team.rank == 0) *key = ~0ull;
        if (warp.index == 0) warp.exclusive_sum(own(), n);  // over all nearer bins
        team.sync();
        for (int first = warp.index * TOGETHER; first < STEPS; first += warp.count * TOGETHER) {
            int deep[TOGETHER], rise[TOGETHER];
            // Most votes so far, and the distance bin at which the step with these votes begins.
            int most[TOGETHER], at[TOGETHER];
            // Votes and inliers of the floor beyond the step in the bins of earlier passes; these bins
            // are farther away.
            int beyond[TOGETHER] = {}, other[TOGETHER] = {};
            bool some = false;
            for (int w = 0; w < TOGETHER; ++w) {
                deep[w] = drop(first + w);
                rise[w] = -deep[w];
                most[w] = -0x7fffffff;
                at[w] = -1;
                some |= deep[w] < 0 || deep[w] > deeper;
            }
            if (!some) continue;
            for (int done = 0; done < n; done += warp.size) {
                const int k = n - 1 - done - warp.lane, place = k < 0 ? 0 : k;
                int here[TOGETHER] = {}, low[TOGETHER] = {};
                if (k >= 0) count<TOGETHER>(k, rise, coarse()[k], here, low);
                const int mine = own()[place], before = flat()[place], wide = 2 * coarse()[place];
                for (int w = 0; w < TOGETHER; ++w) {
                    const int votes_up_to = warp.inclusive_sum(here[w] - each * low[w]);
                    const int cells_up_to = warp.inclusive_sum(here[w]);
                    const int all = before + beyond[w] + votes_up_to;
                    const int size = deep[w] < 0 ? rise[w] : deep[w];
                    const bool counts = (k >= 0) & (size > wide) & (all >= most[w]) &
                                        (OWN * mine >= mine + other[w] + cells_up_to);
                    most[w] = counts ? all : most[w];
                    at[w] = counts ? k : at[w];
                    beyond[w] += warp.broadcast(votes_up_to, warp.size - 1);
                    other[w] += warp.broadcast(cells_up_to, warp.size - 1);
                }
            }
            for (int w = 0; w < TOGETHER; ++w)
                if (at[w] >= 0 && (deep[w] < 0 || deep[w] > deeper))
                    team.atomic_min(key, FloorKey::of(most[w], (first + w) * n + at[w]));
        }
        team.sync();
        const unsigned long long best = *key;
        team.sync();
        votes = FloorKey::votes(best);
        if (best == ~0ull || votes < least) return false;
        const int m = FloorKey::number(best);
        found = {(m % n) << settings->run_bits, 0, drop(m / n)};
        return is_seen_beyond(team, m % n, found.drop);
    }

    // Whether the floor beyond the step extends over some distance, see `extend`; a wall does not. This
    // floor begins at distance bin `from`, `deep` depth units below the plane.
    bool is_seen_beyond(const Team& team, int from, int deep) const {
        const int n = runs();
        for (int k = team.rank; k < n; k += team.size) {
            int low;
            others()[k] = k < from ? 0 : on(k, -deep, coarse()[k], low);
        }
        team.sync();
        int first;
        const bool extends = extend(others(), first);
        team.sync();
        return extends;
    }
};

} }  // namespace jaxdet
