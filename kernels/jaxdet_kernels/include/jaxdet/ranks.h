// Order statistics: the k-th smallest of many values, by a search over the range of values that counts
// values up to a bound.
//
// With `flip` 0 the order is ascending; with `flip` -1 it is descending: then v stands for ~v, as do
// the bounds and the result, and `^ flip` converts both ways.
#pragma once
#include "warp.h"

namespace jaxdet { namespace {

struct Ranks {
    const Warp& warp;

    explicit Ranks(const Warp& warp) : warp(warp) {}

    // Number of the values first .. end - 1 that are at most `limit`; a collective call of the warp.
    int up_to(const int* values, int flip, int first, int end, int limit) const {
        int count = 0;
        for (int i = first + warp.lane; i < end; i += warp.size)
            count += (values[i] ^ flip) <= limit;
        return warp.sum(count);
    }

    // Returns the value at index `place` of the sorted values first .. end - 1, if it lies within low
    // .. high: the smallest that at least `place` + 1 values do not exceed. A collective call of the
    // warp. Other values may lie outside the bounds.
    //
    // Each round counts at three values between the bounds and leaves a quarter of the range.
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
