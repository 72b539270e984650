// Order statistics: the k-th smallest of many values, by a search over values that counts how many
// are at most so large.
//
// Values are taken as they are (`flip` 0) or in falling order (`flip` -1): then v stands for ~v,
// and so do the bounds and the result; `^ flip` turns both ways.
#pragma once
#include "warp.h"

namespace jaxdet { namespace {

struct Ranks {
    const Warp& warp;

    explicit Ranks(const Warp& warp) : warp(warp) {}

    // How many of the values first .. end - 1 are at most `limit`. All lanes ask together.
    int up_to(const int* values, int flip, int first, int end, int limit) const {
        int count = 0;
        for (int i = first + warp.lane; i < end; i += warp.size)
            count += (values[i] ^ flip) <= limit;
        return warp.sum(count);
    }

    // The smallest value that more than `place` of the values first .. end - 1 do not exceed, if
    // it lies within low .. high: the one at `place` in their order. All lanes ask together.
    // Values below `low` or above `high` may be any.
    //
    // Each round looks at three values between the bounds and so leaves a quarter.
    int at(const int* values, int flip, int first, int end, int place, int low, int high) const {
        while (low < high) {
            const int part = (high - low) >> 2;
            const int a = low + part, b = a + part, c = b + part + (((high - low) & 3) == 3);
            int to_a = 0, to_b = 0, to_c = 0;
            for (int i = first + warp.lane; i < end; i += warp.size) {
                const int value = values[i] ^ flip;
                to_a += value <= a;
                to_b += value <= b;
                to_c += value <= c;
            }
            if (warp.sum(to_b) > place) {
                if (warp.sum(to_a) > place) {
                    high = a;
                } else {
                    low = a + 1;
                    high = b;
                }
            } else if (warp.sum(to_c) > place) {
                low = b + 1;
                high = c;
            } else {
                low = c + 1;
            }
        }
        return low;
    }
};

} }  // namespace jaxdet
