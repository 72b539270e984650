// Lock-free union-find with path halving. The root is the smallest member of a set; sets are merged by
// compare-and-swap, so the parent of a root only ever decreases.
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
