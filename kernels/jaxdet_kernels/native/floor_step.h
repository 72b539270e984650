// A step down ahead of a plane, by votes on the floor's profile.
// Twin of jaxdet/reference/_floor_step.py; the constants are its.
#pragma once
#include "floor_profile.h"

struct FloorSteps : FloorProfile {
    enum { DROPS = 28, OWN = 4 };

    // Cells on the plane nearer than each distance.
    int* own() const { return row(5); }

    // At most how many votes a plane whose cells are sorted gets with any step: each cell that does
    // not lie above it gives one.
    void limit(const Team& team, int* found) const {
        const int *heights = sorted(), *at = places + 3 * cells.count;
        int here = 0;
        for (int i = team.rank; i < begin()[runs()]; i += team.size)
            here += heights[i] < index(fine()[at[i]]);
        if (here) team.add(found, here);
    }

    // The first step with most votes of a plane whose cells are sorted, of those deeper than
    // `deeper`, and its votes; false where these are fewer than `least`.
    bool step(const Team& team, int least, int deeper, FloorAhead& found, int& votes) const {
        const int n = runs(), each = FloorScore::BELOW_COST;
        const Warp warp(team);
        count(team);
        if (team.rank == 0) *key = ~0ull;
        for (int k = team.rank; k < n; k += team.size) {
            int low;
            own()[k] = on(k, 0, fine()[k], low);
            flat()[k] = own()[k] - each * low;
        }
        team.sync();
        if (warp.index == 0) warp.run_up(own(), n);
        if (warp.index == 1 % warp.count) warp.run_up(flat(), n);
        team.sync();
        for (int i = warp.index; i < DROPS; i += warp.count) {
            const int drop = (i + 1) * settings[FloorSetting::DROP];
            // Of the lower floor, beyond the distances that the lanes are at.
            int beyond = 0, lower = 0;
            for (int done = 0; done < n; done += warp.size) {
                const int k = n - 1 - done - warp.rank;
                int here = 0, low = 0;
                if (k >= 0) here = on(k, -drop, coarse()[k], low);
                const int votes_up_to = warp.sum_up_to(here - each * low);
                const int cells_up_to = warp.sum_up_to(here);
                if (k >= 0 && drop > 2 * coarse()[k] && drop > deeper) {
                    const int all = flat()[k] + beyond + votes_up_to, mine = own()[k];
                    if (all >= least && OWN * mine >= mine + lower + cells_up_to)
                        team.least(key, key_of(all, i * n + k));
                }
                beyond += warp.from(votes_up_to, warp.size - 1);
                lower += warp.from(cells_up_to, warp.size - 1);
            }
        }
        team.sync();
        const unsigned long long best = *key;
        team.sync();
        if (best == ~0ull) return false;
        const int m = (int)(best & 0xffffffffu);
        votes = votes_of(best);
        found = {(m % n) << settings[FloorSetting::RUN_BITS], 0,
                 (m / n + 1) * settings[FloorSetting::DROP]};
        return true;
    }

    // Cells at a distance on a floor so much above the plane; and those clearly below it.
    int on(int k, int height, int slack, int& low) const {
        low = 0;
        if (begin()[k] == begin()[k + 1]) return 0;
        const int ends[3] = {index(height + slack), index(height - slack),
                             index(height - FloorScore::BELOW * slack)};
        int under[3];
        lower(k, ends, under, 3);
        low = under[2];
        return under[0] - under[1];
    }
};
