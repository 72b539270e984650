// How strong a corner of an edge image is: the smaller eigenvalue of the gradients' covariance in a
// 3x3 window (Shi and Tomasi). Twin of `min_eigenvalue` in jaxdet/reference/_corners.py, which is
// OpenCV's to the bit.
//
// The reference adds products of gradients in float64, in a running sum down each column, so a
// strength depends on all rows above. Here it does not, but for a few pixels:
//
// - A pixel is 0 or 255, so a gradient is one of few values: dx = h k in float32, h = -4 .. 4, and
//   dy = round(g k) - round(g' k), g = 0 .. 4. Their products are multiples of 2^-31 and at least
//   2^-8, and sums of nine are at most 1: float64 and 32-bit integers hold such sums exactly,
//   whatever the order.
// - The exceptions are windows like 100/001/100, where h = 0, but the fused multiply-add of the
//   reference leaves dx = 2^-34. Its square vanishes beside any other product; where there is no
//   other the strength is not positive, so there is no corner.
// - dx dy is then `residue` = 1.3 * 2^-37. Nine of them and what rounding makes of them in a
//   column's sum, at most 2^-54 for each of two operations a row, are less than 2^-33. So the true
//   sum is within 2^-33 of the integers' one. The eigenvalue falls as that sum's size rises, as all
//   roundings keep the order. If it is the same at both ends of the interval, it is exact.
// - Else, for a few pixels in a hundred near edges, `CornerColumn` repeats the reference's sum.
#pragma once
#include "pixel_bits.h"
#include "square_root.h"

namespace jaxdet { namespace {

struct CornerStrength {
    // What OpenCV multiplies gradients of bytes by, in float32: 1 / (4 * 3 * 255), and twice that.
    static float scale() { return (float)(1.0 / (4.0 * 3.0 * 255.0)); }
    static float twice_scale() { return (float)(2.0 / (4.0 * 3.0 * 255.0)); }

    // Of a step from 0 to 255.
    static float step() { return (float)(255.0 * (double)scale()); }

    static float unit() { return 1.0f / 2147483648.0f; }    // 2^-31
    static float per_unit() { return 2147483648.0f; }

    // The eigenvalue, of sums of dx dx, dx dy and dy dy.
    static float eigenvalue(float xx, float xy, float yy) {
        const float a = 0.5f * xx, c = 0.5f * yy, t = a - c;
        return (a + c) - SquareRoot::rounded(t * t + xy * xy);
    }

    // Both ends of where the size of a sum of dx dy may lie, of the integers' sum.
    static float least(int sum) {
        const double size = (double)(sum < 0 ? -sum : sum) - 0.25;
        return size > 0.0 ? (float)size * unit() : 0.0f;
    }
    static float most(int sum) { return (float)((double)(sum < 0 ? -sum : sum) + 0.25) * unit(); }

    // A gradient of the middle pixel of rows of three bits, of which the middle one is the second.
    static int across(unsigned three) { return (int)(three >> 2 & 1) - (int)(three & 1); }
    static int smooth(unsigned three) {
        return (int)(three & 1) + (int)(three >> 1 & 1) * 2 + (int)(three >> 2 & 1);
    }
    static float along(unsigned above, unsigned below) {
        return (float)smooth(below) * step() - (float)smooth(above) * step();
    }

    // The products in multiples of 2^-31.
    static void products(unsigned above, unsigned own, unsigned below, int* xx, int* xy, int* yy) {
        const float dx = (float)(across(above) + 2 * across(own) + across(below)) * step();
        const float dy = along(above, below);
        *xx = (int)(dx * dx * per_unit());
        *xy = (int)(dx * dy * per_unit());
        *yy = (int)(dy * dy * per_unit());
    }
};

// A column of an edge image's pixels: sums of products as the reference's, in float64.
struct CornerColumn {
    const unsigned* edges;  // (height, PixelBits::words(width))
    int height, width;
    int x;

    struct State {
        double running;   // The sum of these two, as rounding left it.
        double oldest, older;  // Sums of three columns in the rows row - 1 and row.
        int row;          // The next whose sum is asked for.
        unsigned near;    // Its five columns, and those of the row below, 5 bits each.
    };

    // Columns x - 2 .. x + 2 of a row; rows are mirrored, columns where a product needs it.
    unsigned five(int y) const {
        const unsigned* row = edges
            + (size_t)PixelBits::mirrored(y, height) * PixelBits::words(width);
        const int from = x - 2;
        if (from >= 0 && x + 2 < width) {
            const int w = from >> 5, shift = from & 31;
            unsigned bits = row[w] >> shift;
            if (shift > 27) bits |= row[w + 1] << (32 - shift);
            return bits & 31;
        }
        unsigned bits = 0;
        for (int k = 0; k < 5; ++k) {
            const int u = PixelBits::mirrored(from + k, width);
            if (u >= 0) bits |= (row[u >> 5] >> (u & 31) & 1) << k;
        }
        return bits;
    }

    // dx dy of the middle pixel of three rows of three bits.
    static double product(unsigned above, unsigned own, unsigned below) {
        const int outer = CornerStrength::across(above) + CornerStrength::across(below);
        const float middle = (float)(255 * CornerStrength::across(own))
            * CornerStrength::twice_scale();
        const float dx = (float)((double)(255 * outer) * (double)CornerStrength::scale()
                                 + (double)middle);
        return (double)(dx * CornerStrength::along(above, below));
    }

    // The sum of dx dy over three columns, of the rows y - 1, y and y + 1.
    double row_sum(unsigned above, unsigned own, unsigned below) const {
        if ((above | own | below) == 0) return 0.0;
        // Products beside the image are mirrored, so the windows are those of the columns inside.
        const int left = x > 0 ? 0 : 2, right = x < width - 1 ? 2 : 0;
        const double sides = product(above >> left & 7, own >> left & 7, below >> left & 7)
            + product(above >> 1 & 7, own >> 1 & 7, below >> 1 & 7);
        return sides + product(above >> right & 7, own >> right & 7, below >> right & 7);
    }

    double row_sum(int y) const {
        y = PixelBits::mirrored(y, height);
        return row_sum(five(y - 1), five(y), five(y + 1));
    }

    State start() const {
        const double above = row_sum(-1), own = row_sum(0);
        return {above + own, above, own, 0, five(0) | five(1) << 5};
    }

    // The sum of dx dy around row state.row, which moves on to the next, of that of row + 1.
    static float add(State* state, double newest) {
        const double total = state->running + newest;
        *state = {total - state->oldest, state->older, newest, state->row + 1, state->near};
        return (float)total;
    }

    float next(State* state) const {
        const int row = state->row + 1;
        if (row == height) return add(state, row_sum(row));
        const unsigned above = state->near & 31, own = state->near >> 5, below = five(row + 1);
        state->near = own | below << 5;
        return add(state, row_sum(above, own, below));
    }

    // The strength of row y's pixel, of its sum of dx dy.
    float strength(int y, float xy) const {
        unsigned xx = 0, yy = 0;
        const int shifts[3] = {x > 0 ? 0 : 2, 1, x < width - 1 ? 2 : 0};
        for (int k = -1; k <= 1; ++k) {
            const int row = PixelBits::mirrored(y + k, height);
            const unsigned above = five(row - 1), own = five(row), below = five(row + 1);
            for (int i = 0; i < 3; ++i) {
                int xx_one, xy_one, yy_one;
                CornerStrength::products(above >> shifts[i] & 7, own >> shifts[i] & 7,
                                         below >> shifts[i] & 7, &xx_one, &xy_one, &yy_one);
                xx += xx_one;
                yy += yy_one;
            }
        }
        return CornerStrength::eigenvalue((float)xx * CornerStrength::unit(), xy,
                                          (float)yy * CornerStrength::unit());
    }
};

} }  // namespace jaxdet
