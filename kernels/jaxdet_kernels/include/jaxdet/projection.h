// Projection of points on rays of the depth camera into the colour image (Eq. 1-4), with the operations
// of librealsense. Twin of jaxdet/reference/_lens.py. Each operation must be rounded separately, so
// compile without fused multiply-add.
#pragma once
#include "square_root.h"
#include "team.h"

namespace jaxdet { namespace {

// Interval arithmetic on floats. Rounding is monotonic, so an operation on the ends of intervals bounds
// the rounded results of that operation on all numbers in them.
struct Interval {
    float low, high;

    Interval(float value) : low(value), high(value) {}
    Interval(float low, float high) : low(low), high(high) {}

    friend Interval operator+(Interval a, Interval b) { return {a.low + b.low, a.high + b.high}; }
    friend Interval operator*(Interval a, Interval b) {
        const float p = a.low * b.low, q = a.low * b.high, r = a.high * b.low, s = a.high * b.high;
        return {lower(lower(p, q), lower(r, s)), higher(higher(p, q), higher(r, s))};
    }
    // Unbounded if the divisor may be close to 0 or negative. The ends are finite, because 0 times
    // infinity is NaN.
    friend Interval operator/(Interval a, Interval b) {
        if (!(b.low > 1e-6f)) return {-1e12f, 1e12f};
        return {a.low / (a.low < 0 ? b.low : b.high), a.high / (a.high < 0 ? b.high : b.low)};
    }

private:
    static float lower(float a, float b) { return a < b ? a : b; }
    static float higher(float a, float b) { return a > b ? a : b; }
};

struct Projection {
    enum { PINHOLE, PLUMB_BOB, RATIONAL, EQUIDISTANT, PARAMETERS = 26 };
    enum { FAR = 1 << 20 };  // larger than the index of any column or row of an image
    // Parameters, by index: 0-8 rotation from the depth to the colour camera; 9-11 translation [m];
    // 12-15 fx, fy, cx and cy [pixel]; 16-23 lens coefficients; 24 largest x^2 + y^2 of a visible ray
    // (x, y, 1) of the colour camera; 25 metres per depth unit.
    const float* p;
    int model;

    // The lens model is stored in the element after the parameters.
    static Projection of(const float* parameters) {
        return {parameters, static_cast<int>(parameters[PARAMETERS])};
    }

    // Column and row in the colour image, depth in the colour camera [depth units], and whether the
    // point is in front of the camera and inside the range of the lens model.
    struct Point {
        int u, v, z;
        bool seen;
    };

    // Arctangent of x >= 0 [rad], as in Cephes, with basic arithmetic only and without branches.
    __attribute__((always_inline)) static double arctangent(double x) {
        const bool large = x > 2.414213562373095, middle = !large & (x > 0.66);
        const double offset = large ? 1.5707963267948966 : middle ? 0.7853981633974483 : 0.0;
        const double over = large ? -1.0 : middle ? x - 1.0 : x;
        const double t = over / (large ? x : middle ? x + 1.0 : 1.0);
        const double z = t * t;
        double above = -8.750608600031904122785e-1;
        above = above * z + -1.615753718733365076637e1;
        above = above * z + -7.500855792314704667340e1;
        above = above * z + -1.228866684490136173410e2;
        above = above * z + -6.485021904942025371773e1;
        double below = z + 2.485846490142306297962e1;
        below = below * z + 1.650270098316988542046e2;
        below = below * z + 4.328810604912902668951e2;
        below = below * z + 4.853903996359136964868e2;
        below = below * z + 1.945506571482613964425e2;
        return offset + (t * (z * above / below) + t);
    }

    // Distorts a ray (x, y, 1) by the model of Kannala and Brandt, in float64.
    __attribute__((always_inline)) void equidistant(float& x, float& y) const {
        const double wx = x, wy = y, r = SquareRoot::rounded(wx * wx + wy * wy);
        const double theta = arctangent(r), t2 = theta * theta;
        double series = (double)p[18] + t2 * (double)p[19];
        series = 1.0 + t2 * ((double)p[16] + t2 * ((double)p[17] + t2 * series));
        const double scale = r > 1.0e-9 ? (theta * series) / r : 1.0;
        x = (float)(wx * scale);
        y = (float)(wy * scale);
    }

    // Distorts a ray (x, y, 1) by OpenCV's radial and tangential distortion; x and y are floats or
    // intervals, and r2 is x^2 + y^2.
    template <class T>
    __attribute__((always_inline)) void brown_conrady(T& x, T& y, T r2) const {
        T radial = 1.0f + r2 * (p[16] + r2 * (p[17] + r2 * p[20]));
        if (model == RATIONAL)
            radial = radial / (1.0f + r2 * (p[21] + r2 * (p[22] + r2 * p[23])));
        const T xy = 2.0f * (x * y);
        const T dx = x * radial + (p[18] * xy + p[19] * (r2 + 2.0f * (x * x)));
        const T dy = y * radial + (p[19] * xy + p[18] * (r2 + 2.0f * (y * y)));
        x = dx;
        y = dy;
    }

    // Point in the colour camera's optical frame [m], as floats or intervals.
    template <class T> struct Moved {
        T x, y, z;
    };

    // Transforms the point at `depth` [m] on the ray (x, y, 1) of the depth camera to the colour
    // camera.
    template <class T>
    __attribute__((always_inline)) Moved<T> moved(T depth, T x, T y) const {
        const T px = depth * x, py = depth * y;
        return {p[0] * px + (p[1] * py + (p[2] * depth + p[9])),
                p[3] * px + (p[4] * py + (p[5] * depth + p[10])),
                p[6] * px + (p[7] * py + (p[8] * depth + p[11]))};
    }

    // Computes the pixel of the point at depth `units` [depth units] on the ray (x, y, 1) of the depth
    // camera; `bends` is true for a lens with distortion. Loops over points can be vectorized, because
    // the only branch is on the model, functions are inlined, and points that are not visible take the
    // same path. The result is an output parameter because a returned struct would be packed into
    // words.
    __attribute__((always_inline)) void through(
        int units, float x, float y, bool bends, Point* at) const {
        const float depth = (float)units * p[25];
        const Moved<float> point = moved(depth, x, y);
        const bool ahead = point.z > 0.0f;
        const float over = ahead ? point.z : 1.0f;
        float bx = point.x / over, by = point.y / over;
        const float r2 = bx * bx + by * by;
        bool seen = ahead & (r2 <= p[24]);
        if (bends && model == EQUIDISTANT) {
            equidistant(bx, by);
        } else if (bends) {
            brown_conrady(bx, by, r2);
        }
        const float column = bx * p[12] + p[14] + 0.5f, row = by * p[13] + p[15] + 0.5f;
        const float limit = FAR;
        seen = seen & (column < limit) & (column > -limit) & (row < limit) & (row > -limit);
        const float z = over / p[25] + 0.5f;
        at->u = (int)(seen ? column : 0.0f);
        at->v = (int)(seen ? row : 0.0f);
        at->z = (int)(z < 65534.0f ? z : 65534.0f);
        at->seen = seen;
    }

    // Box of pixels from (left, top) to (right, bottom), both included.
    struct Bounds {
        int left, top, right, bottom;
    };

    // Bounds of the pixels that `through` computes for points at the depths `units` [depth units] on
    // the rays (x, y, 1).
    Bounds bounds(Interval units, Interval x, Interval y) const {
        const Bounds unbounded{-FAR, -FAR, FAR, FAR};
        const Moved<Interval> point = moved(units * p[25], x, y);
        Interval bx = point.x / point.z, by = point.y / point.z;
        if (model != PINHOLE) {
            const Interval r2 = bx * bx + by * by;
            if (model == EQUIDISTANT || !(r2.high < 1e6f)) return unbounded;
            brown_conrady(bx, by, r2);
        }
        const Interval column = bx * p[12] + p[14] + 0.5f, row = by * p[13] + p[15] + 0.5f;
        return {whole(column.low), whole(row.low), whole(column.high), whole(row.high)};
    }

    // Rounds towards zero, after clipping to -FAR .. FAR.
    static int whole(float value) {
        const float limit = FAR;
        return (int)(value > limit ? limit : value < -limit ? -limit : value);
    }
};

} }  // namespace jaxdet
