// Emulation of CUDA blocks and warps on a CPU, so that tests run kernels without a GPU.
//
// The threads of a block take turns: each runs until it reaches a collective operation of its warp or
// block (a shuffle, a vote, a barrier) and continues once all threads have reached the same one. If
// threads reach different operations, or wait for threads that have ended, that is an error. Only
// complete warps are supported. A warp runs as far as it can before the next one, last warp first, so
// that most missing barriers are detected; races within a warp are not.
#pragma once
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <ucontext.h>

#include <algorithm>
#include <functional>
#include <vector>

#define __CUDA_ARCH__ 900
#define __shared__ static
#define __noinline__
#define __forceinline__ inline
#define __align__(bytes) __attribute__((aligned(bytes)))

struct Place {
    int x;
};
static Place threadIdx, blockDim, gridDim;

struct Simt {
    enum { STACK = 1 << 18 };
    // A warp or block, whose threads synchronize. Values of the last two operations are kept.
    struct Group {
        int size, arrived, turn;
        const char* kind;
        std::vector<unsigned long long> values[2];
    };
    struct Thread {
        ucontext_t context;
        std::vector<char> stack;
        bool is_done;
    };
    std::vector<Thread> threads;
    std::vector<Group> warps;
    Group block;
    ucontext_t main;
    std::function<void()> body;
    long steps;

    static Simt& one() {
        static Simt simt;
        return simt;
    }
    static void start() {
        Simt& s = one();
        s.body();
        s.threads[threadIdx.x].is_done = true;
        ++s.steps;
        swapcontext(&s.threads[threadIdx.x].context, &s.main);
    }
    void run(int count, std::function<void()> work) {
        body = work;
        blockDim.x = count;
        gridDim.x = 1;
        if ((int)threads.size() < count) threads.resize(count);
        warps.assign(count / 32, Group{});
        for (Group& warp : warps) reset(warp, 32);
        reset(block, count);
        for (int i = 0; i < count; ++i) {
            Thread& t = threads[i];
            t.is_done = false;
            if (t.stack.empty()) t.stack.resize(STACK);
            getcontext(&t.context);
            t.context.uc_stack.ss_sp = t.stack.data();
            t.context.uc_stack.ss_size = STACK;
            t.context.uc_link = nullptr;
            makecontext(&t.context, start, 0);
        }
        for (bool some = true; some;) {
            some = false;
            const long before = steps;
            for (int warp = count / 32 - 1; warp >= 0; --warp)
                for (long last = -1; last != steps;) {
                    last = steps;
                    for (int i = 32 * warp; i < 32 * warp + 32; ++i) {
                        if (threads[i].is_done) continue;
                        some = true;
                        threadIdx.x = i;
                        swapcontext(&main, &threads[i].context);
                    }
                }
            if (some && steps == before) fail("deadlock: threads wait for threads that have ended");
        }
        if (block.arrived) fail("a barrier was not reached by all threads of the block");
        for (Group& warp : warps)
            if (warp.arrived) fail("an operation was not reached by all threads of a warp");
    }
    static void reset(Group& group, int size) {
        group.size = size;
        group.arrived = group.turn = 0;
        for (auto& values : group.values) values.assign(size, 0);
    }
    static void fail(const char* what) {
        fprintf(stderr, "%s\n", what);
        abort();
    }
    // Returns the values of all threads of the group, after all have reached the same operation.
    const std::vector<unsigned long long>& meet(Group& group, const char* kind,
                                                unsigned long long value) {
        const int turn = group.turn, self = threadIdx.x;
        if (group.arrived == 0) group.kind = kind;
        if (strcmp(group.kind, kind)) fail("threads of a group reached different operations");
        group.values[turn % 2][self % group.size] = value;
        ++steps;
        if (++group.arrived == group.size) {
            group.arrived = 0;
            ++group.turn;
        } else {
            while (group.turn == turn) swapcontext(&threads[self].context, &main);
        }
        return group.values[turn % 2];
    }
    const std::vector<unsigned long long>& warp(const char* kind, unsigned long long value) {
        return meet(warps[threadIdx.x / 32], kind, value);
    }
};

template <class T> unsigned long long as_word(T value) {
    unsigned long long word = 0;
    memcpy(&word, &value, sizeof value);
    return word;
}
template <class T> T from_word(unsigned long long word) {
    T value;
    memcpy(&value, &word, sizeof value);
    return value;
}
inline void check_complete(unsigned mask) {
    if (mask != 0xffffffffu) Simt::fail("not a complete warp");
}
template <class T> T shuffled(const char* kind, T value, int from) {
    const auto& all = Simt::one().warp(kind, as_word(value));
    return from < 0 || from > 31 ? value : from_word<T>(all[from]);
}
template <class T> T __shfl_sync(unsigned mask, T value, int from) {
    if (mask == 1u << threadIdx.x % 32) return value;
    check_complete(mask);
    return shuffled("shfl", value, from & 31);
}
template <class T> T __shfl_up_sync(unsigned mask, T value, int by) {
    check_complete(mask);
    return shuffled("up", value, threadIdx.x % 32 - by);
}
template <class T> T __shfl_down_sync(unsigned mask, T value, int by) {
    check_complete(mask);
    return shuffled("down", value, threadIdx.x % 32 + by);
}
template <class T> T __shfl_xor_sync(unsigned mask, T value, int by) {
    check_complete(mask);
    return shuffled("xor", value, (threadIdx.x % 32) ^ by);
}
inline int __float_as_int(float value) {
    int bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}
inline float __int_as_float(int bits) {
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}
inline unsigned __ballot_sync(unsigned mask, int mine) {
    check_complete(mask);
    const auto& all = Simt::one().warp("ballot", mine != 0);
    unsigned bits = 0;
    for (int i = 0; i < 32; ++i) bits |= (unsigned)all[i] << i;
    return bits;
}
template <class T, class Combine> T reduced(const char* kind, T mine, Combine combine) {
    const auto& all = Simt::one().warp(kind, as_word(mine));
    T found = from_word<T>(all[0]);
    for (int i = 1; i < 32; ++i) found = combine(found, from_word<T>(all[i]));
    return found;
}
inline int __reduce_add_sync(unsigned mask, int mine) {
    check_complete(mask);
    return reduced("add", mine, [](int a, int b) { return (int)((unsigned)a + (unsigned)b); });
}
inline int __reduce_min_sync(unsigned mask, int mine) {
    check_complete(mask);
    return reduced("min", mine, [](int a, int b) { return a < b ? a : b; });
}
inline unsigned __reduce_min_sync(unsigned mask, unsigned mine) {
    check_complete(mask);
    return reduced("min", mine, [](unsigned a, unsigned b) { return a < b ? a : b; });
}
inline int __reduce_max_sync(unsigned mask, int mine) {
    check_complete(mask);
    return reduced("max", mine, [](int a, int b) { return a < b ? b : a; });
}
inline void __syncwarp() { Simt::one().warp("syncwarp", 0); }
inline void __syncthreads() { Simt::one().meet(Simt::one().block, "sync", 0); }
inline int __syncthreads_or(int mine) {
    const auto& all = Simt::one().meet(Simt::one().block, "or", mine != 0);
    int any = 0;
    for (auto one : all) any |= one != 0;
    return any;
}
// For Team::atomic_count: each thread counts by itself.
inline unsigned __activemask() { return 1u << threadIdx.x % 32; }
inline unsigned __match_any_sync(unsigned mask, unsigned long long) { return mask; }
inline int __ffs(unsigned v) { return __builtin_ffs((int)v); }
inline int __clz(int v) { return v ? __builtin_clz(v) : 32; }
inline int __popc(unsigned v) { return __builtin_popcount(v); }
inline float __fsqrt_rn(float v) { return __builtin_sqrtf(v); }
inline double __dsqrt_rn(double v) { return __builtin_sqrt(v); }
template <class T> T atomicAdd(T* place, T value) {
    const T before = *place;
    *place = *place + value;
    return before;
}
template <class T> T atomicMax(T* place, T value) {
    const T before = *place;
    *place = std::max(*place, value);
    return before;
}
template <class T> T atomicMin(T* place, T value) {
    const T before = *place;
    *place = std::min(*place, value);
    return before;
}
template <class T> T atomicOr(T* place, T value) {
    const T before = *place;
    *place = *place | value;
    return before;
}
template <class T> T atomicExch(T* place, T value) {
    const T before = *place;
    *place = value;
    return before;
}
template <class T> T atomicCAS(T* place, T expected, T value) {
    const T before = *place;
    if (before == expected) *place = value;
    return before;
}
template <class T> T __ldg(const T* place) { return *place; }
inline int min(int a, int b) { return a < b ? a : b; }
inline int max(int a, int b) { return a > b ? a : b; }
