// Square roots: of floats, rounded to nearest; of integers below 2^44, rounded down.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct SquareRoot {
#if defined(__CUDA_ARCH__)
    static float rounded(float value) { return __fsqrt_rn(value); }
    static double rounded(double value) { return __dsqrt_rn(value); }
#else
    static float rounded(float value) { return __builtin_sqrtf(value); }
    static double rounded(double value) { return __builtin_sqrt(value); }
#endif
    static int of(unsigned long long square) {
        unsigned long long left = square, found = 0, bit = 1ull << 42;
        while (bit > square) bit >>= 2;
        for (; bit; bit >>= 2) {
            const bool fits = left >= found + bit;
            left -= fits ? found + bit : 0;
            found = (found >> 1) + (fits ? bit : 0);
        }
        return (int)found;
    }
};

} }  // namespace jaxdet
