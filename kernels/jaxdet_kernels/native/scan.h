// Prefix sums of a team.
#pragma once
#include "team.h"

struct PrefixSum {
    // Words of scratch memory: one for each thread of the largest team.
    enum { WORDS = 1024 };

    // Each of the n values becomes the sum of those before it. All threads must call it, after a
    // sync. Returns the sum of all; the values may be read at once.
    static int run(const Team& team, int* values, int n, int* scratch) {
        const int share = (n + team.size - 1) / team.size;
        const int begin = share * team.rank < n ? share * team.rank : n;
        const int end = begin + share < n ? begin + share : n;
        int own = 0;
        for (int i = begin; i < end; ++i) own += values[i];
        scratch[team.rank] = own;
        team.sync();
        int before = 0, total = 0;
        for (int t = 0; t < team.size; ++t) {
            if (t < team.rank) before += scratch[t];
            total += scratch[t];
        }
        for (int i = begin; i < end; ++i) {
            const int value = values[i];
            values[i] = before;
            before += value;
        }
        team.sync();
        return total;
    }
};
