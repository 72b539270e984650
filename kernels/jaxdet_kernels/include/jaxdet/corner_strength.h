// Corner strength of an edge image: the smaller eigenvalue of the gradients' covariance in a 3x3 window
// (Shi and Tomasi). Twin of `corner_strength` in jaxdet/reference/paper/_corners.py.
//
// A pixel is 0 or 255, so a gradient takes few values: dx = h k in float32, h = -4 .. 4, and dy = g k -
// g' k, g = 0 .. 4. Their products are multiples of 2^-31, so integer sums are exact and independent of
// the order.
#pragma once
#include "square_root.h"

namespace jaxdet { namespace {

// Sums of products of gradients [2^-31] over pixels of a column, and over windows.
struct GradientSums {
    unsigned xx = 0, yy = 0;
    int xy = 0;

    // Adds the products at the middle pixel of three rows, each given as three bits. Inlined, so that
    // loops over columns can be vectorized.
    __attribute__((always_inline)) void add(int above, int own, int below, int sign) {
        const int across = right(above) - left(above) + 2 * (right(own) - left(own)) + right(below)
            - left(below);
        const float dx = (float)across * step(), unit = 2147483648.0f;
        const float dy = (float)smooth(below) * step() - (float)smooth(above) * step();
        xx += (unsigned)(int)(dx * dx * unit);
        yy += (unsigned)(int)(dy * dy * unit);
        xy += (int)(dx * dy * unit) * sign;
    }

    static int left(int three) { return three & 1; }
    static int right(int three) { return three >> 2 & 1; }
    static int smooth(int three) { return left(three) + right(three) + (three & 2); }

    // A step from 0 to 255 in OpenCV's scale of gradients, 1 / (4 * 3 * 255).
    static float step() { return (float)(255.0 * (double)(float)(1.0 / (4.0 * 3.0 * 255.0))); }
};

struct CornerStrength {
    union Float {
        float value;
        int bits;
    };

    // Strength as the bits of a float, whose order is that of the floats; 0 if it is not positive.
    static int of(unsigned xx, int xy, unsigned yy) {
        const float unit = 1.0f / 2147483648.0f;
        const float a = 0.5f * ((float)xx * unit), c = 0.5f * ((float)yy * unit), t = a - c;
        const float b = (float)xy * unit;
        const Float found = {(a + c) - SquareRoot::rounded(t * t + b * b)};
        return found.bits > 0 ? found.bits : 0;
    }
};

} }  // namespace jaxdet
