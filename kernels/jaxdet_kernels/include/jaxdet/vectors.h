// Vectors of numbers. On the CPU they are extensions that Clang (Warp's compiler) and GCC share; on
// processors with narrower vectors the compiler uses several registers. On CUDA, where the threads of a
// warp are the lanes, they are single numbers.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

// Words are unsigned numbers of at least 16 bits, one per Word of memory; Wide has an int for each of
// them. `least` is the smallest of Words, `widen` converts Words, and `divide` divides as floats and
// rounds towards zero.
struct Vectors {
#if defined(__CUDA_ARCH__)
    enum { SHORTS = 1, INTS = 1 };
    typedef unsigned Word, Words;
    typedef int Wide, Ints;

    static int least(Words value) { return (int)value; }
    static void widen(Words value, Wide* out) { *out = (int)value; }
    static void divide(Wide a, Wide b, Wide* out) { *out = (int)((float)a / (float)b); }
#else
    enum { SHORTS = 32, INTS = 16 };
    typedef unsigned short Word;
    typedef unsigned char Bytes __attribute__((vector_size(32), aligned(1), may_alias));
    typedef unsigned short Words __attribute__((vector_size(64), aligned(2), may_alias));
    typedef int Wide __attribute__((vector_size(128), aligned(4), may_alias));
    typedef int Ints __attribute__((vector_size(64), aligned(4), may_alias));
    typedef float WideFloats __attribute__((vector_size(128), aligned(4), may_alias));

    static int least(const Words& values) {
#if defined(__clang__)
        return __builtin_reduce_min(values);
#else
        unsigned short low = values[0];
        for (int i = 1; i < SHORTS; ++i) low = values[i] < low ? values[i] : low;
        return low;
#endif
    }
    __attribute__((always_inline)) static void widen(const Words& values, Wide* out) {
        *out = __builtin_convertvector(values, Wide);
    }
    __attribute__((always_inline)) static void divide(const Wide& a, const Wide& b, Wide* out) {
        const WideFloats quotients =
            __builtin_convertvector(a, WideFloats) / __builtin_convertvector(b, WideFloats);
        *out = __builtin_convertvector(quotients, Wide);
    }
#endif
};

} }  // namespace jaxdet
