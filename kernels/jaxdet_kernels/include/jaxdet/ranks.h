// Order statistics: the k-th smallest of many values. It is found by a search over the range of values,
// in which each round counts the values that are at most a bound.
//
// With `flip` 0 the order is ascending, and with `flip` -1 it is descending. In descending order, bounds
// and results are complements: ~v instead of v. `^ flip` converts in both directions.
#pragma once
#include "warp.h"

namespace jaxdet { namespace {

struct Ranks {
    const Warp& warp;

    explicit Ranks(const Warp& warp) : warp(warp) {}

    // Number of the values first .. end - 1 that are at most `limit`. All lanes of the warp must call
    // it.
    int up_to(const int* values, int flip, int first, int end, int limit) const {
        int count = 0;
        for (int i = first + warp.lane; i < end; i += warp.size)
            count += (values[i] ^ flip) <= limit;
        return warp.sum(count);
    }

    // Returns the value at index `place` of the values first .. end - 1 in sorted order, i.e. the
    // smallest v such that at least `place` + 1 of them are at most v. This value must lie within low ..
    // high; the others need not. All lanes of the warp must call it.
    //
    // Each round divides the range at three bounds, counts the values up to each of them, and continues
    // with one quarter.
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
