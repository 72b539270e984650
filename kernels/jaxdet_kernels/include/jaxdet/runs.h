// Connected components of the cells of a frame, by runs: cells of a row that are linked one to the
// next. Runs are numbered by a prefix sum and joined by union-find.
#pragma once
#include "bits.h"
#include "union_find.h"
#include "warp.h"

namespace jaxdet { namespace {

// The runs of all rows, numbered from the upper left, and the sets that they are linked to.
struct Runs {
    BitRows on, starts;  // cells of runs, and which of them a run begins with
    int* before;         // how many runs begin before each word, and how many there are
    UnionFind sets;      // of runs
    int* sizes;          // by the root, the cells of a set

    // Finds `before`; how many runs there are. All threads must call it, after a sync; ends in one.
    int count(const Team& team) const {
        const int words = starts.count();
        for (int i = team.rank; i < words; i += team.size) before[i] = BitRows::popcount(starts[i]);
        team.sync();
        const Warp warp(team);
        if (warp.index == 0) warp.exclusive_sum(before, words);
        team.sync();
        return before[words];
    }

    // Numbers the runs, each a set of its own; ends in a sync. All threads must call it, after a
    // sync. `near` has room for the sets of `most` runs and is used where that is enough.
    int number(const Team& team, int* near, int most) {
        const int count = this->count(team);
        if (count <= most) sets.parent = near;
        for (int run = team.rank; run < count; run += team.size) {
            sets.parent[run] = run;
            sizes[run] = 0;
        }
        team.sync();
        return count;
    }

    // The run of bit k of word i.
    int at(int i, int k) const {
        return before[i] + BitRows::popcount(starts[i] & ((2u << k) - 1)) - 1;
    }

    // The cells of one run in word i, and these taken off `rest`, which is `on[i]` at first.
    unsigned next(int i, unsigned* rest) const {
        const unsigned low = *rest & -*rest, up_to = low | (low - 1);
        const unsigned stop = (~on[i] | starts[i]) & ~up_to;
        const unsigned cells = ((stop & -stop) - 1) & ~(low - 1);
        *rest &= ~cells;
        return cells;
    }

    // Links the runs of two cells, of bits k and l.
    void link(const Team& team, int i, int k, int j, int l) const {
        sets.link(team, at(i, k), at(j, l));
    }

    // Adds up the sizes of the sets; ends in a sync.
    void measure(const Team& team) const {
        for (int i = team.rank; i < on.count(); i += team.size)
            for (unsigned rest = on[i]; rest;) {
                const unsigned cells = next(i, &rest);
                const int root = sets.find(at(i, BitRows::lowest(cells)));
                team.atomic_add(sizes + root, BitRows::popcount(cells));
            }
        team.sync();
    }
};

} }  // namespace jaxdet
