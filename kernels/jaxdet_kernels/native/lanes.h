// The threads that work on one piece of a frame together, without waiting for the others of their
// team: a warp on CUDA, a single thread on the CPU.
//
//     for (int piece = lanes.index; piece < pieces; piece += lanes.count)
//         for (int i = lanes.rank; i < n; i += lanes.size) ...
//
// All lanes ask for a sum, a minimum or a maximum together, and all get it.
#pragma once
#include "team.h"

struct Lanes {
#if defined(__CUDA_ARCH__)
    enum { size = 32 };
    int rank, index, count;

    explicit Lanes(const Team& team)
        : rank(team.rank % size), index(team.rank / size), count(team.size / size) {}
#else
    enum { rank = 0, size = 1, index = 0, count = 1 };

    explicit Lanes(const Team&) {}
#endif

    int sum(int value) const {
#if defined(__CUDA_ARCH__)
        for (int away = 16; away; away >>= 1) value += __shfl_xor_sync(0xffffffff, value, away);
#endif
        return value;
    }

    int least(int value) const {
#if defined(__CUDA_ARCH__)
        for (int away = 16; away; away >>= 1) {
            const int other = __shfl_xor_sync(0xffffffff, value, away);
            value = other < value ? other : value;
        }
#endif
        return value;
    }

    int most(int value) const { return -least(-value); }

    // How many lanes before this one say so, and how many in all; all lanes must ask.
    int before(bool mine, int* all) const {
#if defined(__CUDA_ARCH__)
        const unsigned those = __ballot_sync(0xffffffff, mine);
        *all = __popc(those);
        return __popc(those & ((1u << rank) - 1));
#else
        *all = mine;
        return 0;
#endif
    }
};
