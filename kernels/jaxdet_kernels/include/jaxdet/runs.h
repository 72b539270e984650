// Connected components of the cells of a frame, by runs of linked cells in a row. Runs are numbered by
// a prefix sum and merged by union-find.
#pragma once
#include "bits.h"
#include "union_find.h"
#include "warp.h"

namespace jaxdet { namespace {

// Runs of all rows, numbered in raster order, and the components that they belong to.
struct Runs {
    BitRows on, starts;  // cells of runs, and first cells of runs
    int* before;         // number of runs that begin before each word, and the total
    UnionFind sets;      // components of runs
    int* sizes;          // number of cells of a component, indexed by its root

    // Numbers the runs, each of which becomes its own component; returns their number. A collective
    // call, after a sync; ends in a sync. `near` has room for the parents of `most` runs and is used if
    // there are at most that many.
    int number(const Team& team, int* near, int most) {
        const int count = count_before(team, starts, before);
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
