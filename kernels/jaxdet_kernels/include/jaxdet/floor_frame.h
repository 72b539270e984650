// Where a point of the camera is on the floor: right, forward and height, in whole depth units.
// Twin of `on_floor` in jaxdet/floor/frame.py: `FLOOR_VALUES` integers a frame, as FloorFrame has
// them.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct FloorFrame {
    enum { BITS = 13, VALUES = 13, UNKNOWN = 1 << 20, LOW = (1 << BITS) - 1 };
    // Three axes of three parts with BITS fraction bits, at most 1: right, forward, down.
    int axes[9];
    int height, valid, ramp_start, ramp_slope;

    explicit FloorFrame(const int* floor)
        : height(floor[9]), valid(floor[10]), ramp_start(floor[11]), ramp_slope(floor[12]) {
        for (int i = 0; i < 9; ++i) axes[i] = floor[i];
    }

    // The rounded sum of products. Coordinates are taken apart, so that 32 bits are enough for any.
    int along(int axis, int x, int y, int z) const {
        const int a = axes[3 * axis], b = axes[3 * axis + 1], c = axes[3 * axis + 2];
        const int fine = a * (x & LOW) + b * (y & LOW) + c * (z & LOW);
        const int coarse = a * (x >> BITS) + b * (y >> BITS) + c * (z >> BITS);
        return coarse + ((fine + (1 << (BITS - 1))) >> BITS);
    }

    int right(int x, int y, int z) const { return along(0, x, y, z); }
    int forward(int x, int y, int z) const { return along(1, x, y, z); }

    // Above the plane, without a ramp on it.
    int level(int x, int y, int z) const {
        return valid ? height - along(2, x, y, z) : (int)UNKNOWN;
    }

    bool has_ramp() const { return valid && ramp_slope; }

    // How much the ramp raises the floor at a point that is `ahead` forward.
    int rise(int ahead) const {
        const long long run = (long long)ahead - ramp_start;
        return run > 0 ? (int)(run * ramp_slope >> BITS) : 0;
    }
};

} }  // namespace jaxdet
