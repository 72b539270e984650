// The threads that process one frame together: a block on CUDA, a single thread on the CPU.
//
// Code for a team is written once. Work is divided by
//
//     for (int i = team.rank; i < n; i += team.size) ...
//     team.sync();
//
// Writes of several threads to one address go through the atomic functions below. On the CPU rank is 0,
// size is 1, and the atomics are plain memory operations. Results must not depend on the order in which
// threads arrive: integer sums, minima and maxima do not.
//
// The inner namespace of each header is anonymous: a module of kernels is one translation unit, and
// clang inlines a function with a single caller only if no other unit can see it (7 % of the run time).
#pragma once
#if __has_include(<stddef.h>)  // without this header, size_t is predefined
#include <stddef.h>
#endif

// Declares memory that the threads of a team share: shared memory on CUDA, the stack on the CPU.
#if defined(__CUDA_ARCH__)
#define JAXDET_SHARED __shared__ __align__(16)
#else
#define JAXDET_SHARED alignas(16)
#endif

// Placed before a loop with a constant number of iterations, to unroll the loop completely.
#if defined(__CUDA_ARCH__) && defined(__CUDACC__)
#define JAXDET_UNROLL_ON_CUDA _Pragma("unroll")
#define JAXDET_UNROLL JAXDET_UNROLL_ON_CUDA
#elif defined(__clang__)
#define JAXDET_UNROLL_ON_CUDA
#define JAXDET_UNROLL _Pragma("clang loop unroll(full)")
#else
#define JAXDET_UNROLL_ON_CUDA
#define JAXDET_UNROLL
#endif

// Placed before a loop, to vectorize it on the CPU although its pointers might overlap.
#if defined(__clang__)
#define JAXDET_VECTORIZE _Pragma("clang loop vectorize(assume_safety)")
#else
#define JAXDET_VECTORIZE
#endif

namespace jaxdet { namespace {

struct Team {
    // sync          barrier of all threads, after which each sees the writes of the others
    // any           whether `mine` is true in any thread; a collective call
    // input         load of read-only data, which the compiler may move before stores
    // atomic_...    update of an address, returns the previous value
    // atomic_cas    compare and swap: stores `value` if the address holds `expected`
    // atomic_count  increment; threads of a warp with the same address are aggregated
#if defined(__CUDA_ARCH__)
    int rank, size, index;

    Team(int tid, int share)
        : rank(threadIdx.x), size(blockDim.x), index(share + tid / (int)blockDim.x) {}

    void sync() const { __syncthreads(); }
    bool any(bool mine) const { return __syncthreads_or(mine); }

    static int input(const int* place) { return __ldg(place); }
    static unsigned char input(const unsigned char* place) { return __ldg(place); }

    template <class T> T atomic_add(T* place, T value) const { return atomicAdd(place, value); }
    template <class T> T atomic_min(T* place, T value) const { return atomicMin(place, value); }
    template <class T> T atomic_max(T* place, T value) const { return atomicMax(place, value); }
    int atomic_or(int* place, int bits) const { return atomicOr(place, bits); }
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
#else
    enum { rank = 0, size = 1 };
    int index;

    Team(int tid, int share) : index(share + tid) {}

    void sync() const {}
    bool any(bool mine) const { return mine; }

    static int input(const int* place) { return *place; }
    static unsigned char input(const unsigned char* place) { return *place; }

    template <class T> static T replace(T* place, T value) {
        const T before = *place;
        *place = value;
        return before;
    }
    template <class T> T atomic_add(T* place, T value) const { return replace(place, *place + value); }
    template <class T> T atomic_min(T* place, T value) const {
        return replace(place, value < *place ? value : *place);
    }
    template <class T> T atomic_max(T* place, T value) const {
        return replace(place, value > *place ? value : *place);
    }
    int atomic_or(int* place, int bits) const { return replace(place, *place | bits); }
    int atomic_cas(int* place, int expected, int value) const {
        return *place == expected ? replace(place, value) : *place;
    }
    int atomic_count(int* place) const { return (*place)++; }
#endif
};

#if !defined(__CUDA_ARCH__)
// Takes frames that no other thread has taken, and calls `work(b)` for each, until none is left; `next` is
// the index of the next free frame. All frames share one launch because after each launch a Python thread
// would have to wait for the interpreter lock.
template <class Work> void each_frame(int* next, int frames, Work work) {
    for (;;) {
        const int b = __atomic_fetch_add(next, 1, __ATOMIC_RELAXED);
        if (b >= frames) return;
        work((size_t)b);
    }
}
#endif

// Calls `work(b, team, near, own)` for the frames of a batch. On CUDA the teams of a launch share the
// frames, on the CPU its threads take them one by one. `near` is in the fastest memory of a team;
// `own` is the team's share of the scratch memory, which has `words` words for all teams.
template <class Near, class Work>
void by_frames(int tid, int frames, int* next, int* scratch, int words, Work work) {
    const Team team(tid, 0);
    JAXDET_SHARED Near near;
#if defined(__CUDA_ARCH__)
    int* const own = scratch + (size_t)team.index * (words / gridDim.x);
    for (int b = team.index; b < frames; b += gridDim.x) {
        work((size_t)b, team, near, own);
        team.sync();
    }
#else
    each_frame(next, frames, [&](size_t b) { work(b, team, near, scratch); });
#endif
}

} }  // namespace jaxdet
