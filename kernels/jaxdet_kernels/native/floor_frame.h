// Where a point of the camera is on the floor: right, forward and height, in whole depth units.
// Twin of jaxdet/reference/_floor_frame.py; `FLOOR_VALUES` integers a frame, as `FloorFrame` has them.
#pragma once
#include "team.h"

struct FloorFrame {
    enum { BITS = 13, VALUES = 13, UNKNOWN = 1 << 20 };
    // Three axes of three parts with BITS fraction bits: right, forward, down.
    const int* axes;
    int height, valid, ramp_start, ramp_slope;

    explicit FloorFrame(const int* floor)
        : axes(floor), height(floor[9]), valid(floor[10]), ramp_start(floor[11]),
          ramp_slope(floor[12]) {}

    int along(int axis, int x, int y, int z) const {
        const int* a = axes + 3 * axis;
        const long long sum = (long long)a[0] * x + (long long)a[1] * y + (long long)a[2] * z;
        return (int)((sum + (1 << (BITS - 1))) >> BITS);
    }

    int right(int x, int y, int z) const { return along(0, x, y, z); }
    int forward(int x, int y, int z) const { return along(1, x, y, z); }

    // Above the plane, or above the ramp on it, at a point that is `ahead` forward.
    int above(int x, int y, int z, int ahead) const {
        if (!valid) return UNKNOWN;
        const int run = ahead - ramp_start;
        const long long rise = run > 0 ? (long long)run * ramp_slope >> BITS : 0;
        return height - along(2, x, y, z) - (int)rise;
    }
};
