// Vectors of pixels on the CPU, in what Clang (Warp's compiler) and GCC have in common. Where a
// processor's vectors are narrower the compiler takes several.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

#if !defined(__CUDA_ARCH__)
struct Vectors {
    enum { SHORTS = 32, FLOATS = 16, BYTES = 64, LONGS = 8 };
    typedef unsigned char Bytes __attribute__((vector_size(64), aligned(1), may_alias));
    typedef short Shorts __attribute__((vector_size(64), aligned(2), may_alias));
    typedef unsigned short Words __attribute__((vector_size(64), aligned(2), may_alias));
    typedef int Wide __attribute__((vector_size(128), aligned(4), may_alias));
    typedef int Ints __attribute__((vector_size(64), aligned(4), may_alias));
    typedef unsigned Unsigned __attribute__((vector_size(64), aligned(4), may_alias));
    typedef unsigned long long Longs __attribute__((vector_size(64), aligned(8), may_alias));
    typedef float Floats __attribute__((vector_size(64), aligned(4), may_alias));
    typedef float WideFloats __attribute__((vector_size(128), aligned(4), may_alias));
    typedef double Doubles __attribute__((vector_size(128), aligned(8), may_alias));

    // bits   which lanes hold: bit i is lane i; they are 0 or -1, as comparisons give them
    // any    whether any bit is set
    // pick   `yes` in the lanes of these bits and 0 in the others
    // least, root
#if defined(__clang__)
    typedef bool Flags16 __attribute__((ext_vector_type(16)));
    typedef bool Flags32 __attribute__((ext_vector_type(32)));

    static unsigned bits(const Shorts& condition) {
        const Flags32 packed = __builtin_convertvector(condition, Flags32);
        unsigned word;
        __builtin_memcpy(&word, &packed, sizeof word);
        return word;
    }
    static unsigned bits(const Ints& condition) {
        const Flags16 packed = __builtin_convertvector(condition, Flags16);
        unsigned short word;
        __builtin_memcpy(&word, &packed, sizeof word);
        return word;
    }
    static bool any(const Longs& values) { return __builtin_reduce_or(values) != 0; }
    static void pick(unsigned word, float yes, Floats* out) {
        const unsigned short low = (unsigned short)word;
        Flags16 flags;
        __builtin_memcpy(&flags, &low, sizeof low);
        *out = __builtin_convertvector(flags, Ints) != 0 ? (Floats){} + yes : (Floats){};
    }
    static unsigned short least(const Words& values) { return __builtin_reduce_min(values); }
    static void root(const Floats& values, Floats* out) {
        *out = __builtin_elementwise_sqrt(values);
    }
#else
    static unsigned bits(const Shorts& condition) {
        unsigned word = 0;
        for (int i = 0; i < SHORTS; ++i) word |= (unsigned)(condition[i] != 0) << i;
        return word;
    }
    static unsigned bits(const Ints& condition) {
        unsigned word = 0;
        for (int i = 0; i < FLOATS; ++i) word |= (unsigned)(condition[i] != 0) << i;
        return word;
    }
    static bool any(const Longs& values) {
        unsigned long long all = 0;
        for (int i = 0; i < LONGS; ++i) all |= values[i];
        return all != 0;
    }
    static void pick(unsigned word, float yes, Floats* out) {
        for (int i = 0; i < FLOATS; ++i) (*out)[i] = word >> i & 1 ? yes : 0.0f;
    }
    static unsigned short least(const Words& values) {
        unsigned short low = values[0];
        for (int i = 1; i < SHORTS; ++i) low = values[i] < low ? values[i] : low;
        return low;
    }
    static void root(const Floats& values, Floats* out) {
        for (int i = 0; i < FLOATS; ++i) (*out)[i] = __builtin_sqrtf(values[i]);
    }
#endif
};
#endif

} }  // namespace jaxdet
