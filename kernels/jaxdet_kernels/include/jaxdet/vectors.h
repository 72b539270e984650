// Vector types for the CPU, from the extensions that Clang (Warp's compiler) and GCC share. On
// processors with narrower vectors the compiler uses several registers.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

#if !defined(__CUDA_ARCH__)
struct Vectors {
    enum { SHORTS = 32 };
    typedef unsigned char Bytes __attribute__((vector_size(32), aligned(1), may_alias));
    typedef unsigned short Words __attribute__((vector_size(64), aligned(2), may_alias));
    typedef int Wide __attribute__((vector_size(128), aligned(4), may_alias));
    typedef int Ints __attribute__((vector_size(64), aligned(4), may_alias));
    typedef float WideFloats __attribute__((vector_size(128), aligned(4), may_alias));

    static unsigned short least(const Words& values) {
#if defined(__clang__)
        return __builtin_reduce_min(values);
#else
        unsigned short low = values[0];
        for (int i = 1; i < SHORTS; ++i) low = values[i] < low ? values[i] : low;
        return low;
#endif
    }
};
#endif

} }  // namespace jaxdet
