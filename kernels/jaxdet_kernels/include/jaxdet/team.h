// The threads that work on one frame together: a block on CUDA, a single thread on the CPU.
//
// Code for a team is written once. Work is shared out by
//
//     for (int i = team.rank; i < n; i += team.size) ...
//     team.sync();
//
// and what threads of a team write to one place goes through the atomic functions below. On the
// CPU rank is 0, size is 1, and all of this is plain memory. Results must not depend on the order
// in which threads arrive: sums, minima and maxima of integers do not.
//
// Each header's inner namespace has no name: a module of kernels is one translation unit, and clang
// inlines a function that is called once only where no other unit can see it (7 % of the run time).
#pragma once
#if __has_include(<stddef.h>)  // else size_t is there from the start
#include <stddef.h>
#endif

namespace jaxdet { namespace {

struct Team {
    // sync          all threads wait for each other, and see what the others wrote
    // any           whether any thread says so; all threads must ask
    // input         what the kernel writes nowhere, so that the load may be moved before stores
    // atomic_...    change a place and return what was there before
    // atomic_cas    compare and swap: writes `value` where `expected` is
    // atomic_count  adds one; threads of a warp that count at one place add together
#if defined(__CUDA_ARCH__)
    int rank, size, index;

    Team(int tid, int share)
        : rank(threadIdx.x), size(blockDim.x), index(share + tid / (int)blockDim.x) {}

    void sync() const { __syncthreads(); }
    bool any(bool mine) const { return __syncthreads_or(mine); }

    static int input(const int* place) { return __ldg(place); }
    static bool input(const bool* place) { return __ldg((const unsigned char*)place); }
    static unsigned char input(const unsigned char* place) { return __ldg(place); }
    static unsigned long long input(const unsigned long long* place) { return __ldg(place); }

    int atomic_add(int* place, int value) const { return atomicAdd(place, value); }
    int atomic_min(int* place, int value) const { return atomicMin(place, value); }
    int atomic_max(int* place, int value) const { return atomicMax(place, value); }
    void atomic_min(unsigned* place, unsigned value) const { atomicMin(place, value); }
    int atomic_or(int* place, int bits) const { return atomicOr(place, bits); }
    int atomic_exchange(int* place, int value) const { return atomicExch(place, value); }
    int atomic_cas(int* place, int expected, int value) const {
        return atomicCAS(place, expected, value);
    }
    int atomic_count(int* place) const {
        const unsigned same = __match_any_sync(__activemask(), (unsigned long long)place);
        const int lane = threadIdx.x % 32, first = __ffs(same) - 1;
        int before = 0;
        if (lane == first) before = atomicAdd(place, __popc(same));
        return __shfl_sync(same, before, first) + __popc(same & ((1u << lane) - 1));
    }
    void atomic_add(unsigned long long* place, unsigned long long value) const {
        atomicAdd(place, value);
    }
    void atomic_min(unsigned long long* place, unsigned long long value) const {
        atomicMin(place, value);
    }
#else
    enum { rank = 0, size = 1 };
    int index;

    Team(int tid, int share) : index(share + tid) {}

    void sync() const {}
    bool any(bool mine) const { return mine; }

    static int input(const int* place) { return *place; }
    static bool input(const bool* place) { return *place; }
    static unsigned char input(const unsigned char* place) { return *place; }
    // Also of eight bytes that were written as such.
    static unsigned long long input(const unsigned long long* place) {
        unsigned long long word;
        __builtin_memcpy(&word, place, sizeof word);
        return word;
    }

    static int replace(int* place, int value) {
        const int before = *place;
        *place = value;
        return before;
    }
    int atomic_add(int* place, int value) const { return replace(place, *place + value); }
    int atomic_min(int* place, int value) const {
        return value < *place ? replace(place, value) : *place;
    }
    int atomic_max(int* place, int value) const {
        return value > *place ? replace(place, value) : *place;
    }
    int atomic_or(int* place, int bits) const { return replace(place, *place | bits); }
    int atomic_exchange(int* place, int value) const { return replace(place, value); }
    int atomic_cas(int* place, int expected, int value) const {
        return *place == expected ? replace(place, value) : *place;
    }
    int atomic_count(int* place) const { return (*place)++; }
    void atomic_min(unsigned* place, unsigned value) const {
        *place = value < *place ? value : *place;
    }
    void atomic_add(unsigned long long* place, unsigned long long value) const { *place += value; }
    void atomic_min(unsigned long long* place, unsigned long long value) const {
        *place = value < *place ? value : *place;
    }
#endif
};

#if !defined(__CUDA_ARCH__)
// Does `work(b)` for frames that no other thread has taken, until there are none; `next` is the
// first of those. One launch for all: after a launch a thread of Python would wait for its lock.
template <class Work> void each_frame(int* next, int frames, Work work) {
    for (;;) {
        const int b = __atomic_fetch_add(next, 1, __ATOMIC_RELAXED);
        if (b >= frames) return;
        work((size_t)b);
    }
}
#endif

} }  // namespace jaxdet
