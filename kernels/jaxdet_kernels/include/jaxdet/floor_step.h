// Detection of a step ahead of a plane, down or up, by votes on the profile of the floor. Twin of
// jaxdet/reference/_floor_step.py, which documents the constants.
#pragma once
#include "floor_profile.h"

namespace jaxdet { namespace {

struct FloorSteps : FloorProfile {
    enum { DROPS = 28, RISES = 10, STEPS = DROPS + RISES, OWN = 4 };
    // Number of candidate steps that are tried together: all of them on the CPU.
    enum { ABREAST = Warp::size > 1 ? 1 : STEPS };

    // `own` is the number of inliers of the plane in all nearer distance bins; `others` is the number
    // of inliers of the floor beyond the step in this distance bin.
    int* own() const { return row(5); }
    int* others() const { return row(6); }

    // Drop of the floor at candidate step `i` [depth units]; the steps down come first.
    int drop(int i) const {
        const int each = settings->drop_spacing;
        return i < DROPS ? (i + 1) * each : -(i - DROPS + 1) * each;
    }

    // Finds the step with the most votes, the first of several with equal votes, and its number of
    // votes. Returns false if it has fewer than `least` votes, or if the floor beyond the step is not
    // visible over some distance. A step down must be deeper than `deeper` [depth units]. `sort` and
    // FloorRamps::limits must have run for this plane, with the fine tolerance.
    bool step(const Team& team, int least, int deeper, FloorAhead& found, int& votes) const {
        const int n = runs(), each = FloorScore::BELOW_COST;
        const Warp warp(team);
        if (team.rank == 0) *key = ~0ull;
        for (int k = team.rank; k < n; k += team.size) {
            int low;
            own()[k] = on(k, 0, fine()[k], low);
        }
        team.sync();
        if (warp.index == 0) warp.exclusive_sum(own(), n);
        team.sync();
        for (int first = warp.index * ABREAST; first < STEPS; first += warp.count * ABREAST) {
            int deep[ABREAST], rise[ABREAST];
            // Most votes so far, and the distance bin at which the step with these votes begins.
            int most[ABREAST], at[ABREAST];
            // Votes and inliers of the floor beyond the step in the bins of earlier passes; these bins
            // are farther away.
            int beyond[ABREAST] = {}, other[ABREAST] = {};
            bool some = false;
            for (int w = 0; w < ABREAST; ++w) {
                deep[w] = drop(first + w);
                rise[w] = -deep[w];
                most[w] = -0x7fffffff;
                at[w] = -1;
                some |= deep[w] < 0 || deep[w] > deeper;
            }
            if (!some) continue;
            for (int done = 0; done < n; done += warp.size) {
                const int k = n - 1 - done - warp.lane, place = k < 0 ? 0 : k;
                int here[ABREAST] = {}, low[ABREAST] = {};
                if (k >= 0) count<ABREAST>(k, rise, coarse()[k], here, low);
                const int mine = own()[place], before = flat()[place], wide = 2 * coarse()[place];
                for (int w = 0; w < ABREAST; ++w) {
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
            for (int w = 0; w < ABREAST; ++w)
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
        return is_seen(team, m % n, found.drop);
    }

    // Whether the floor beyond the step is visible over some distance, which a wall is not. It begins
    // at distance bin `from`, `deep` depth units below the plane.
    bool is_seen(const Team& team, int from, int deep) const {
        const int n = runs();
        for (int k = team.rank; k < n; k += team.size) {
            int low;
            others()[k] = k < from ? 0 : on(k, -deep, coarse()[k], low);
        }
        team.sync();
        int first, last;
        spread(others(), first, last);
        team.sync();
        return middle(last) - middle(first) > settings->spread;
    }
};

} }  // namespace jaxdet
