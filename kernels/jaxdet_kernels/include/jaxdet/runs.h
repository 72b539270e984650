// Connected components of the cells of a frame, by runs of linked cells in a row. Runs are numbered by
// a prefix sum and merged by union-find.
#pragma once
#include "bits.h"
#include "team.h"
#include "warp.h"

namespace jaxdet { namespace {

// Lock-free union-find with path halving. The root is the smallest member of a set. Sets are merged by
// compare-and-swap, so that a parent only decreases.
struct UnionFind {
    int* parent;

    int find(int one) const {
        volatile int* up = parent;
        int above = up[one];
        while (above != one) {
            const int next = up[above];
            up[one] = next;
            one = above;
            above = next;
        }
        return one;
    }

    // Returns the root without changing parents, for use while other threads write roots to `parent`.
    int root(int one) const {
        while (parent[one] != one) one = parent[one];
        return one;
    }

    void link(const Team& team, int one, int two) const {
        while (true) {
            one = find(one);
            two = find(two);
            if (one == two) return;
            const int high = one > two ? one : two, low = one > two ? two : one;
            if (team.atomic_cas(parent + high, high, low) == high) return;
        }
    }
};

// Runs of all rows, numbered in raster order, and the components that they belong to.
struct Runs {
    BitRows on, starts;  // cells of runs, and first cells of runs
    int* before;         // number of runs that begin before each word, and the total
    UnionFind sets;      // components of runs
    int* sizes;          // number of cells of a component, indexed by its root

    // Computes `before`; returns the number of runs. A collective call, after a sync; ends in a sync.
    int count(const Team& team) const {
        const int words = starts.count();
        for (int i = team.rank; i < words; i += team.size) before[i] = BitRows::popcount(starts[i]);
        team.sync();
        const Warp warp(team);
        if (warp.index == 0) warp.exclusive_sum(before, words);
        team.sync();
        return before[words];
    }

    // Numbers the runs, each of which becomes its own component; returns their number. A collective
    // call, after a sync; ends in a sync.
    int number(const Team& team) {
        const int count = this->count(team);
        for (int run = team.rank; run < count; run += team.size) {
            sets.parent[run] = run;
            sizes[run] = 0;
        }
        team.sync();
        return count;
    }

    // Number of the run that contains bit k of word i.
    int at(int i, int k) const {
        return before[i] + BitRows::popcount(starts[i] & ((2u << k) - 1)) - 1;
    }

    // Returns the cells of the next run in word i and removes them from `rest`, which is `on[i]` at
    // first.
    unsigned next(int i, unsigned* rest) const {
        const unsigned low = *rest & -*rest, up_to = low | (low - 1);
        const unsigned stop = (~on[i] | starts[i]) & ~up_to;
        const unsigned cells = ((stop & -stop) - 1) & ~(low - 1);
        *rest &= ~cells;
        return cells;
    }

    // Merges the components of two cells: bit k of word i and bit l of word j.
    void link(const Team& team, int i, int k, int j, int l) const {
        sets.link(team, at(i, k), at(j, l));
    }

    // Computes the sizes of the components. Ends in a sync.
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
