// Settings of Canny and of the corners' selection, as jaxdet/stages/_corners.py puts them together.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct CornerSettings {
    enum { LOW, HIGH, LIMIT, QUALITY, EVERYWHERE = QUALITY + 2, COUNT };
    const int* values;  // (COUNT)

    // Canny's thresholds, from -1 to 2047, the lower first.
    int low() const { return values[LOW]; }
    int high() const { return values[HIGH]; }

    // The square of the least distance of two corners, rounded up; 0: none.
    int limit() const { return values[LIMIT]; }

    // Corners are stronger than this share of the strongest allowed pixel: a double in two words.
    double quality() const {
        unsigned long long bits = (unsigned)values[QUALITY + 1];
        bits = bits << 32 | (unsigned)values[QUALITY];
#if defined(__CUDA_ARCH__)
        return __longlong_as_double((long long)bits);
#else
        double value;
        __builtin_memcpy(&value, &bits, sizeof value);
        return value;
#endif
    }

    // All ones: corners may be everywhere, whatever the mask is.
    unsigned long long everywhere() const { return values[EVERYWHERE] ? ~0ull : 0; }
};

} }  // namespace jaxdet
