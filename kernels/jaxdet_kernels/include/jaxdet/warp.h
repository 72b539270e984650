// The threads that execute one task of a frame together, independently of the rest of their team: a
// warp on CUDA, a single thread on the CPU.
//
//     for (int task = warp.index; task < tasks; task += warp.count)
//         for (int i = warp.lane; i < n; i += warp.size) ...
//
// Sums, minima and maxima are collective calls: all lanes must make the call, and all get the result.
#pragma once
#include "bits.h"

namespace jaxdet { namespace {

struct Warp {
    // broadcast      value of one lane
    // ballot         bitmap of the lanes whose argument is true
    // sync           memory barrier of the lanes
    // sum, min, max  reduction over all lanes
    // inclusive_sum  inclusive prefix sum over the lanes
#if defined(__CUDA_ARCH__)
    enum : unsigned { ALL = 0xffffffff };
    enum { size = 32, MOST = 1024 / size };  // MOST: maximum number of warps of a team
    int lane, index, count;

    explicit Warp(const Team& team)
        : lane(team.rank % size), index(team.rank / size), count(team.size / size) {}

    void sync() const { __syncwarp(); }
    int broadcast(int value, int source) const { return __shfl_sync(ALL, value, source); }
    unsigned ballot(bool mine) const { return __ballot_sync(ALL, mine); }

    // Requires compute capability 8.0.
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

    // Atomic add in shared memory.
    void add_shared(int* place, int value) const {
#if defined(__CUDACC__)
        const unsigned at = (unsigned)__cvta_generic_to_shared(place);
        asm volatile("red.shared.add.s32 [%0], %1;" ::"r"(at), "r"(value) : "memory");
#else  // built for the CPU, by tests
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

    // Bitmap of the results of a test for i from 0 to 31, or to n - 1 if that is less; a collective call.
    // The CPU tests several i at once, so a test must not read what the test of another i writes.
    template <class Test> unsigned bits(Test test) const { return bits(BitRows::WIDTH, test); }
    template <class Test> unsigned bits(int n, Test test) const {
#if defined(__CUDA_ARCH__)
        return ballot(lane < n && test(lane));
#else
        unsigned char holds[BitRows::WIDTH];
        n = n < BitRows::WIDTH ? n : (int)BitRows::WIDTH;
        JAXDET_VECTORIZE
        for (int i = 0; i < n; ++i) holds[i] = test(i);
        return BitRows::packed(holds, 0, n);
#endif
    }

    // Calls `use(i)` for each bit i of a word that is set.
    template <class Use> void each_bit(unsigned word, Use use) const {
#if defined(__CUDA_ARCH__)
        if (word >> lane & 1) use(lane);
#else
        for (; word; word &= word - 1) use(BitRows::lowest(word));
#endif
    }

    // Number of earlier lanes whose argument is true; `all` becomes that of all lanes. A collective call.
    int ballot_rank(bool mine, int* all) const {
        const unsigned who = ballot(mine);
        *all = BitRows::popcount(who);
        return BitRows::popcount(who & ((1u << lane) - 1));
    }

    // Exclusive prefix sums, in place: each of the n values is replaced by the sum of those before it,
    // and element n by the total, which is returned. A collective call of one warp; other warps see the
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

// Running minimum and maximum.
struct Extremes {
    enum { MOST = 0x7fffffff };
    int low = MOST, high = -MOST;

    void add(int value) { add(value, value); }
    void add(int lower, int upper) {
        low = lower < low ? lower : low;
        high = upper > high ? upper : high;
    }
    // Reduces over all lanes.
    void join(const Warp& warp) {
        low = warp.min(low);
        high = warp.max(high);
    }
};

} }  // namespace jaxdet
