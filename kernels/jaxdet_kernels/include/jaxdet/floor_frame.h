// Transform of camera points to the floor frame: right, forward and height, in integer depth units.
// Twin of `on_floor` in jaxdet/floor/frame.py. The input is a floor frame of VALUES integers, in the
// order that `FLOOR_VALUES` in that file documents.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct FloorFrame {
    enum { BITS = 13, VALUES = 13, UNKNOWN = 1 << 20, LOW = (1 << BITS) - 1 };
    // Axes right, forward and down in the camera frame: three components each, from -1 to 1, with BITS
    // fraction bits.
    int axes[9];
    // Height of the optical centre; 1 if the floor is known; start of the ramp; slope of the ramp, 0 if
    // there is none. Lengths are in depth units, and the slope has BITS fraction bits.
    int height, valid, ramp_start, ramp_slope;

    explicit FloorFrame(const int* floor)
        : height(floor[9]), valid(floor[10]), ramp_start(floor[11]), ramp_slope(floor[12]) {
        for (int i = 0; i < 9; ++i) axes[i] = floor[i];
    }

    // Dot product of a point with an axis, rounded [depth units]. Coordinates are split into high and
    // low bits, so that 32-bit arithmetic does not overflow.
    int along(int axis, int x, int y, int z) const {
        const int a = axes[3 * axis], b = axes[3 * axis + 1], c = axes[3 * axis + 2];
        const int fine = a * (x & LOW) + b * (y & LOW) + c * (z & LOW);
        const int coarse = a * (x >> BITS) + b * (y >> BITS) + c * (z >> BITS);
        return coarse + ((fine + (1 << (BITS - 1))) >> BITS);
    }

    int right(int x, int y, int z) const { return along(0, x, y, z); }
    int forward(int x, int y, int z) const { return along(1, x, y, z); }

    // Height above the plane [depth units], without the ramp; UNKNOWN if the floor is unknown.
    int level(int x, int y, int z) const {
        return valid ? height - along(2, x, y, z) : (int)UNKNOWN;
    }

    // Whether the camera is on its side, so that columns of cells are not vertical, and whether it is
    // upside down.
    bool is_on_side() const {
        const int aside = axes[6], upright = axes[7];  // x and y of the down vector
        return (aside < 0 ? -aside : aside) > (upright < 0 ? -upright : upright);
    }
    bool is_upside_down() const { return axes[7] < 0; }

    bool has_ramp() const { return valid && ramp_slope; }

    // Height of the ramp above the plane at the forward distance `ahead` [depth units].
    int rise(int ahead) const {
        const long long run = (long long)ahead - ramp_start;
        return run > 0 ? (int)(run * ramp_slope >> BITS) : 0;
    }
};

} }  // namespace jaxdet
