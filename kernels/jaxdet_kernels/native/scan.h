// Prefix sums of a team.
#pragma once
#include "warp.h"

struct PrefixSum {
    // Words of scratch memory: one for each warp of the largest team.
    enum { WORDS = 32 };

    // Each of the n values becomes the sum of those before it. All threads must call it, after a
    // sync. Returns the sum of all; ends in a sync.
    static int run(const Team& team, int* values, int n, int* scratch) {
        const int share = (n + team.size - 1) / team.size;
        const int begin = share * team.rank < n ? share * team.rank : n;
        const int end = begin + share < n ? begin + share : n;
        int own = 0, before = 0, total = 0;
        for (int i = begin; i < end; ++i) own += values[i];
        const Warp warp(team);
        const int up_to = warp.sum_up_to(own);
        if (warp.rank == Warp::size - 1) scratch[warp.index] = up_to;
        team.sync();
        for (int w = 0; w < warp.count; ++w) {
            if (w < warp.index) before += scratch[w];
            total += scratch[w];
        }
        before += up_to - own;
        for (int i = begin; i < end; ++i) {
            const int value = values[i];
            values[i] = before;
            before += value;
        }
        team.sync();
        return total;
    }
};
