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
        union {
            unsigned long long bits;
            double value;
        } both;
        both.bits = (unsigned)values[QUALITY + 1];
        both.bits = both.bits << 32 | (unsigned)values[QUALITY];
        return both.value;
    }

    // Corners may be everywhere, whatever the mask is.
    bool everywhere() const { return values[EVERYWHERE] != 0; }
};

} }  // namespace jaxdet
