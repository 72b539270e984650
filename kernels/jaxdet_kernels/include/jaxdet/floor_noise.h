// Noise of the floor in a frame, as a step height per depth. Twin of jaxdet/reference/_floor_noise.py,
// which documents the rule and the constants.
#pragma once
#include "floor_frame.h"
#include "warp.h"

namespace jaxdet { namespace {

struct FloorNoise {
    enum { LEVELS = 16, TIMES = 3, DIVISOR = 2, SHARE = 100, LEAST = 200 };
    enum { NOISE_BITS = 34, SLOPE_BITS = 14, STEEPEST = 32767, DEEPEST = 65535 };
    const int *z, *height;
    int cells;
    int nearest, farthest;  // range of depths
    int step;               // step height at depth 0
    int* sums;              // two words in the fastest memory of the team

    // Maximum noise for a camera at the height of the frame; `setting` is the noise per depth and per
    // height of the camera, with NOISE_BITS fraction bits.
    static int most(const FloorFrame& frame, int setting) {
        const long long high = frame.height > 0 ? frame.height : 0;
        const long long slope = high * setting >> (NOISE_BITS - SLOPE_BITS);
        return slope < STEEPEST ? (int)slope : (int)STEEPEST;
    }

    // Counts the floor cells, and those that are lower than the noise at this level permits.
    void count(const Team& team, int most, int level, int* floor, int* lower) const {
        if (team.rank == 0) sums[0] = sums[1] = 0;
        team.sync();
        const int deepest = DIVISOR * level;
        int all = 0, deep = 0;
        JAXDET_VECTORIZE
        for (int k = team.rank; k < cells; k += team.size) {
            const int d = z[k], high = height[k], noise = d * most >> SLOPE_BITS;
            const int bound = noise > step ? noise : step;
            const int on = (d >= nearest) & (d <= farthest) & (high <= bound) & (high >= -bound);
            all += on;
            deep += on & (int)(-TIMES * LEVELS * high > deepest * noise);
        }
        const Warp warp(team);
        all = warp.sum(all);
        deep = warp.sum(deep);
        if (warp.lane == 0) {
            team.atomic_add(sums, all);
            team.atomic_add(sums + 1, deep);
        }
        team.sync();
        *floor = sums[0];
        *lower = sums[1];
        team.sync();
    }

    // Returns the noise, at most `most`. All threads of the team must call it.
    int slope(const Team& team, int most) const {
        const long long end = farthest < DEEPEST ? farthest : (int)DEEPEST;
        if (end * most >> SLOPE_BITS <= step) return most;
        int low = 1, high = LEVELS;
        while (low < high) {
            const int level = (low + high) / 2;
            int floor, lower;
            count(team, most, level, &floor, &lower);
            if (floor < LEAST) return most;
            if (SHARE * lower <= floor)
                high = level;
            else
                low = level + 1;
        }
        return most * high / LEVELS;
    }
};

} }  // namespace jaxdet
