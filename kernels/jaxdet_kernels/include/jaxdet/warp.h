// The threads that do one task of a frame together, without waiting for the others of their
// team: a warp on CUDA, a single thread on the CPU.
//
//     for (int task = warp.index; task < tasks; task += warp.count)
//         for (int i = warp.lane; i < n; i += warp.size) ...
//
// All lanes ask for a sum, a minimum or a maximum together, and all get it.
#pragma once
#include "bits.h"

namespace jaxdet { namespace {

struct Warp {
    // broadcast      the value of one lane
    // ballot         bit k: whether lane k says so
    // sync           lanes see what the others wrote
    // sum, min, max  of the values of all lanes
    // inclusive_sum  of the values of the lanes up to this one (a prefix sum)
#if defined(__CUDA_ARCH__)
    enum : unsigned { ALL = 0xffffffff };
    enum { size = 32, MOST = 1024 / size };  // and most warps of a team
    int lane, index, count;

    explicit Warp(const Team& team)
        : lane(team.rank % size), index(team.rank / size), count(team.size / size) {}

    void sync() const { __syncwarp(); }
    int broadcast(int value, int source) const { return __shfl_sync(ALL, value, source); }
    unsigned ballot(bool mine) const { return __ballot_sync(ALL, mine); }

    // From compute capability 8.0 on.
    int sum(int value) const { return __reduce_add_sync(ALL, value); }
    int min(int value) const { return __reduce_min_sync(ALL, value); }
    unsigned min(unsigned value) const { return __reduce_min_sync(ALL, value); }
    long long sum(long long value) const {
        for (int away = 16; away; away >>= 1) value += __shfl_xor_sync(ALL, value, away);
        return value;
    }
    unsigned long long min(unsigned long long value) const {
        for (int away = 16; away; away >>= 1) {
            const unsigned long long other = __shfl_xor_sync(ALL, value, away);
            value = other < value ? other : value;
        }
        return value;
    }
    int inclusive_sum(int value) const {
        for (int away = 1; away < size; away <<= 1) {
            const int other = __shfl_up_sync(ALL, value, away);
            if (lane >= away) value += other;
        }
        return value;
    }

    // Adds to shared memory.
    void add_shared(int* place, int value) const {
#if defined(__CUDACC__)
        const unsigned at = (unsigned)__cvta_generic_to_shared(place);
        asm volatile("red.shared.add.s32 [%0], %1;" ::"r"(at), "r"(value) : "memory");
#else  // tests on the CPU
        *place += value;
#endif
    }
#else
    enum { lane = 0, size = 1, index = 0, count = 1, MOST = 1 };

    explicit Warp(const Team&) {}

    void sync() const {}
    int broadcast(int value, int) const { return value; }
    unsigned ballot(bool mine) const { return mine; }
    int sum(int value) const { return value; }
    int min(int value) const { return value; }
    unsigned min(unsigned value) const { return value; }
    long long sum(long long value) const { return value; }
    unsigned long long min(unsigned long long value) const { return value; }
    int inclusive_sum(int value) const { return value; }
#endif

    int max(int value) const { return -min(-value); }

    // Bit i: whether a test holds of i, from 0 to 31; all lanes ask.
    template <class Test> unsigned bits(Test test) const {
#if defined(__CUDA_ARCH__)
        return ballot(test(lane));
#else
        unsigned char holds[BitRows::WIDTH];
        for (int i = 0; i < BitRows::WIDTH; ++i) holds[i] = test(i);
        return BitRows::packed(holds, 0, BitRows::WIDTH);
#endif
    }

    // This lane's rank among those that say so, and how many these are; all lanes must ask.
    int ballot_rank(bool mine, int* all) const {
        const unsigned who = ballot(mine);
        *all = BitRows::popcount(who);
        return BitRows::popcount(who & ((1u << lane) - 1));
    }

    // Exclusive prefix sums, in place: each of the n values becomes the sum of those before it, and
    // the one after them that of all, which is returned. The lanes of one warp ask; others see the
    // sums after a sync of their team.
    int exclusive_sum(int* values, int n) const {
        int before = 0;
        for (int start = 0; start <= n; start += size) {
            const int i = start + lane, own = i < n ? values[i] : 0;
            const int up_to = inclusive_sum(own);
            if (i <= n) values[i] = before + up_to - own;
            before += broadcast(up_to, size - 1);
        }
        return before;
    }
};

// The least and the largest of some values.
struct Extremes {
    enum { MOST = 0x7fffffff };
    int low = MOST, high = -MOST;

    void add(int value) { add(value, value); }
    void add(int lower, int upper) {
        low = lower < low ? lower : low;
        high = upper > high ? upper : high;
    }
    // Over all lanes.
    void join(const Warp& warp) {
        low = warp.min(low);
        high = warp.max(high);
    }
};

} }  // namespace jaxdet
