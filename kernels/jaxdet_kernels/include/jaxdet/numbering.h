// Numbers groups of labels 0, 1, ... in the order of their first cells. Twin of `renumbered` in
// jaxdet/reference/_surfaces.py.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct Numbering {
    enum { NONE = 1 << 30 };
    int count;
    const int *group, *first;  // per label: representative of its group, first cell
    int *lowest, *rank;        // scratch, (count) each
    int *number, *total;       // results: number per label, and how many groups there are

    // Numbers the groups in the order of their first cells. Ends in a sync.
    void run(const Team& team) const {
        for (int l = team.rank; l < count; l += team.size) lowest[l] = NONE;
        if (team.rank == 0) *total = 0;
        team.sync();
        for (int l = team.rank; l < count; l += team.size)
            team.atomic_min(lowest + group[l], first[l]);
        team.sync();
        for (int l = team.rank; l < count; l += team.size) {
            if (lowest[l] == NONE) continue;
            int before = 0;
            for (int other = 0; other < count; ++other) before += lowest[other] < lowest[l];
            rank[l] = before;
            team.atomic_add(total, 1);
        }
        team.sync();
        for (int l = team.rank; l < count; l += team.size) number[l] = rank[group[l]];
        team.sync();
    }
};

} }  // namespace jaxdet
