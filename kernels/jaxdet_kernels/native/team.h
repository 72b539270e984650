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
// Headers of this folder hold structs only: they become local classes of a kernel, so they have
// no templates and no static members, and include nothing but each other. The one exception
// is size_t for compilers that read a header alone: kernels leave all includes out and have Warp's.
#pragma once
#include <stddef.h>

struct Team {
#if defined(__CUDA_ARCH__)
    int rank, size;
#else
    enum { rank = 0, size = 1 };
#endif
    int index;

    // The team that a kernel's thread `tid` belongs to; `share` is that of the launch.
    Team(int tid, int share) {
#if defined(__CUDA_ARCH__)
        rank = threadIdx.x;
        size = blockDim.x;
        index = share + tid / size;
#else
        index = share + tid;
#endif
    }

    // All threads wait for each other, and see what the others wrote.
    void sync() const {
#if defined(__CUDA_ARCH__)
        __syncthreads();
#endif
    }

    // Reads what the kernel writes nowhere, so that the load may be moved before stores.
    static int input(const int* place) {
#if defined(__CUDA_ARCH__)
        return __ldg(place);
#else
        return *place;
#endif
    }

    static bool input(const bool* place) {
#if defined(__CUDA_ARCH__)
        return __ldg((const unsigned char*)place);
#else
        return *place;
#endif
    }

    // Eight bytes.
    static unsigned long long input(const unsigned long long* place) {
#if defined(__CUDA_ARCH__)
        return __ldg(place);
#else
        return *place;
#endif
    }

    // On the CPU asks for a cache line that is read later, while others are worked on. A CUDA
    // device has other threads meanwhile.
    static void fetch([[maybe_unused]] const void* place) {
#if !defined(__CUDA_ARCH__)
        __builtin_prefetch(place);
#endif
    }

    // Whether any thread says so; all threads must ask.
    bool any(bool mine) const {
#if defined(__CUDA_ARCH__)
        return __syncthreads_or(mine);
#else
        return mine;
#endif
    }

    // Each returns what was there before.
    int add(int* place, int value) const {
#if defined(__CUDA_ARCH__)
        return atomicAdd(place, value);
#else
        const int before = *place;
        *place += value;
        return before;
#endif
    }

    // Adds one; lanes of a warp that count at one place add together.
    int count(int* place) const {
#if defined(__CUDA_ARCH__)
        const unsigned same = __match_any_sync(__activemask(), (unsigned long long)place);
        const int lane = threadIdx.x % 32, first = __ffs(same) - 1;
        int before = 0;
        if (lane == first) before = atomicAdd(place, __popc(same));
        return __shfl_sync(same, before, first) + __popc(same & ((1u << lane) - 1));
#else
        return (*place)++;
#endif
    }

    int least(int* place, int value) const {
#if defined(__CUDA_ARCH__)
        return atomicMin(place, value);
#else
        const int before = *place;
        if (value < before) *place = value;
        return before;
#endif
    }

    int most(int* place, int value) const {
#if defined(__CUDA_ARCH__)
        return atomicMax(place, value);
#else
        const int before = *place;
        if (value > before) *place = value;
        return before;
#endif
    }

    void least(unsigned long long* place, unsigned long long value) const {
#if defined(__CUDA_ARCH__)
        atomicMin(place, value);
#else
        *place = value < *place ? value : *place;
#endif
    }

    void add(unsigned long long* place, unsigned long long value) const {
#if defined(__CUDA_ARCH__)
        atomicAdd(place, value);
#else
        *place += value;
#endif
    }

    // Writes `value` where `expected` is; the value that was there.
    int exchange(int* place, int expected, int value) const {
#if defined(__CUDA_ARCH__)
        return atomicCAS(place, expected, value);
#else
        const int before = *place;
        if (before == expected) *place = value;
        return before;
#endif
    }

    void set(int* place, int bits) const {
#if defined(__CUDA_ARCH__)
        atomicOr(place, bits);
#else
        *place |= bits;
#endif
    }

    int swap(int* place, int value) const {
#if defined(__CUDA_ARCH__)
        return atomicExch(place, value);
#else
        const int before = *place;
        *place = value;
        return before;
#endif
    }
};
