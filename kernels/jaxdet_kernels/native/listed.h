// The cells of a frame that have a label, one after the other: mostly a small part of all.
#pragma once
#include "lanes.h"

struct Listed {
    enum { AHEAD = 4 };
    int* count;
    // Of each: which cell it is, its label, and where it is on the floor. Cells of a row follow each
    // other; on CUDA, groups of AHEAD by 32 cells lie in any order.
    int *cell, *label, *right, *forward;

    // Takes all cells whose label is not negative; `most` becomes at least the largest label and
    // one. `count` and `most` are 0 before. Ends in a sync.
    void take(
        const Team& team, int cells, const int* labels, const int* at_right, const int* at_forward,
        int* most
    ) const {
        int largest = -1;
#if defined(__CUDA_ARCH__)
        enum { GROUP = AHEAD * Lanes::size };
        const Lanes lanes(team);
        for (int first = lanes.index * GROUP; first < cells; first += lanes.count * GROUP) {
            int own[AHEAD], before[AHEAD], found[AHEAD], sum = 0, start = 0;
            for (int k = 0; k < AHEAD; ++k) {
                const int i = first + k * Lanes::size + lanes.rank;
                own[k] = i < cells ? labels[i] : -1;
            }
            for (int k = 0; k < AHEAD; ++k) {
                before[k] = sum + lanes.before(own[k] >= 0, found + k);
                sum += found[k];
            }
            if (sum == 0) continue;
            if (lanes.rank == 0) start = team.add(count, sum);
            start = __shfl_sync(0xffffffff, start, 0);
            for (int k = 0; k < AHEAD; ++k) {
                if (own[k] < 0) continue;
                put(start + before[k], first + k * Lanes::size + lanes.rank, own[k], at_right, at_forward);
                largest = own[k] > largest ? own[k] : largest;
            }
        }
#else
        int n = 0;
        for (int i = 0; i < cells; ++i) {
            if (labels[i] < 0) continue;
            put(n++, i, labels[i], at_right, at_forward);
            largest = labels[i] > largest ? labels[i] : largest;
        }
        *count = n;
#endif
        if (largest >= 0) team.most(most, largest + 1);
        team.sync();
    }

    void put(int i, int from, int own, const int* at_right, const int* at_forward) const {
        cell[i] = from;
        label[i] = own;
        right[i] = at_right[from];
        forward[i] = at_forward[from];
    }
};
