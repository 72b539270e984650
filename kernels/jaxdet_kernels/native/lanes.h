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
    // With compute capability 8.0 a warp's sum, minimum or maximum of integers is one instruction.
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
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
        return __reduce_add_sync(0xffffffff, value);
#elif defined(__CUDA_ARCH__)
        for (int away = 16; away; away >>= 1) value += __shfl_xor_sync(0xffffffff, value, away);
#endif
        return value;
    }

    long long sum(long long value) const {
#if defined(__CUDA_ARCH__)
        for (int away = 16; away; away >>= 1) value += __shfl_xor_sync(0xffffffff, value, away);
#endif
        return value;
    }

    int least(int value) const {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
        return __reduce_min_sync(0xffffffff, value);
#elif defined(__CUDA_ARCH__)
        for (int away = 16; away; away >>= 1) {
            const int other = __shfl_xor_sync(0xffffffff, value, away);
            value = other < value ? other : value;
        }
#endif
        return value;
    }

    int most(int value) const { return -least(-value); }

#if defined(__CUDA_ARCH__)
    // Adds to shared memory.
    void add_shared(int* place, int value) const {
        const unsigned at = (unsigned)__cvta_generic_to_shared(place);
        asm volatile("red.shared.add.s32 [%0], %1;" ::"r"(at), "r"(value) : "memory");
    }
#endif

    unsigned long long least(unsigned long long value) const {
#if defined(__CUDA_ARCH__)
        for (int away = 16; away; away >>= 1) {
            const unsigned long long other = __shfl_xor_sync(0xffffffff, value, away);
            value = other < value ? other : value;
        }
#endif
        return value;
    }

    // The sum of the values of the lanes up to this one.
    int sum_up_to(int value) const {
#if defined(__CUDA_ARCH__)
        for (int away = 1; away < size; away <<= 1) {
            const int other = __shfl_up_sync(0xffffffff, value, away);
            if (rank >= away) value += other;
        }
#endif
        return value;
    }

    // Bit k says so for lane k; all lanes must ask.
    unsigned those(bool mine) const {
#if defined(__CUDA_ARCH__)
        return __ballot_sync(0xffffffff, mine);
#else
        return mine;
#endif
    }

    // Each of the n values becomes the sum of those before it, and the one after them that of all.
    // Returns that of all. The lanes of one warp ask; others see the sums after a sync of their team.
    int run_up(int* values, int n) const {
        int before = 0;
        for (int start = 0; start <= n; start += size) {
            const int i = start + rank, own = i < n ? values[i] : 0;
            const int up_to = sum_up_to(own);
            if (i <= n) values[i] = before + up_to - own;
#if defined(__CUDA_ARCH__)
            before += __shfl_sync(0xffffffff, up_to, size - 1);
#else
            before += up_to;
#endif
        }
        return before;
    }

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
