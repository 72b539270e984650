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
    int* sums;              // COUNTS words in the fastest memory of the team
    enum { COUNTS = 4 };    // of the floor cells, and of the lower ones at three levels

    // Maximum noise for a camera at the height of the frame; `setting` is the noise per depth and per
    // height of the camera, with NOISE_BITS fraction bits.
    static int most(const FloorFrame& frame, int setting) {
        const long long high = frame.height > 0 ? frame.height : 0;
        const long long slope = high * setting >> (NOISE_BITS - SLOPE_BITS);
        return slope < STEEPEST ? (int)slope : (int)STEEPEST;
    }

    // Counts the floor cells, and those that are lower than the noise permits at the levels `from`, plus
    // one, two and three times `apart`. All threads get the counts.
    void count(const Team& team, int most, int from, int apart, int* counts) const {
        for (int i = team.rank; i < COUNTS; i += team.size) sums[i] = 0;
        team.sync();
        const int one = DIVISOR * (from + apart), two = one + DIVISOR * apart, three = two + DIVISOR * apart;
        int floor = 0, a = 0, b = 0, c = 0;
        JAXDET_VECTORIZE
        for (int k = team.rank; k < cells; k += team.size) {
            const int d = z[k], high = height[k], noise = d * most >> SLOPE_BITS;
            const int bound = noise > step ? noise : step, below = -TIMES * LEVELS * high;
            const int on = (d >= nearest) & (d <= farthest) & (high <= bound) & (high >= -bound);
            floor += on;
            a += on & (int)(below > one * noise);
            b += on & (int)(below > two * noise);
            c += on & (int)(below > three * noise);
        }
        const Warp warp(team);
        const int own[COUNTS] = {warp.sum(floor), warp.sum(a), warp.sum(b), warp.sum(c)};
        if (warp.lane == 0)
            for (int i = 0; i < COUNTS; ++i) team.atomic_add(sums + i, own[i]);
        team.sync();
        for (int i = 0; i < COUNTS; ++i) counts[i] = sums[i];
        team.sync();
    }

    // Returns the noise, at most `most`. All threads of the team must call it.
    int slope(const Team& team, int most) const {
        const long long end = farthest < DEEPEST ? farthest : (int)DEEPEST;
        if (end * most >> SLOPE_BITS <= step) return most;
        // The search begins with every fourth level, then tests those between two of them.
        int level = 0;
        for (int apart = LEVELS / 4; apart; apart /= 4) {
            int counts[COUNTS], below = level;
            count(team, most, level, apart, counts);
            if (counts[0] < LEAST) return most;
            for (int i = 1; i < COUNTS; ++i)
                if (SHARE * counts[i] > counts[0]) below = level + i * apart;
            level = below;
        }
        return most * (level + 1) / LEVELS;
    }
};

} }  // namespace jaxdet
