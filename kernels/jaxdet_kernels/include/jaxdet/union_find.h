// Disjoint sets: union-find with path halving, without locks. A root is the smallest member of its
// set; they are joined by compare-and-swap, by which a root only ever gets a smaller one as parent.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

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

} }  // namespace jaxdet
