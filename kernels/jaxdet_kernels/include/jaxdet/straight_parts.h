// Splits a contour where it bends around free floor. Twin of `straight_parts` in
// jaxdet/reference/_outlines.py. The lanes of a warp work on one contour together: all of them execute
// every step, and share the search for the largest triangle.
#pragma once
#include "square_root.h"
#include "warp.h"

namespace jaxdet { namespace {

struct StraightParts {
    enum { FAR_BEHIND = 4, FEWEST = 5, POINT_BITS = 10 };
    enum : long long { MOST_AREA = 1ll << 50 };
    const Warp& warp;
    const int *x, *y;  // the contour, from left to right
    int points;
    long long bend, shortest, jump;
    // `stack` is scratch memory, (points). `parts` is the result, (points + 1): the first point of each
    // part. Every lane writes the same values and reads back its own writes.
    int *stack, *parts;

    long long squared(int a, int b) const {
        const long long right = x[b] - x[a], forward = y[b] - y[a];
        return right * right + forward * forward;
    }

    // Length of a chord, at least 1.
    long long length(int a, int b) const {
        const int found = SquareRoot::of(squared(a, b));
        return found > 1 ? found : 1;
    }

    // Returns twice the area of the largest triangle of a chord and a point behind it, and this point.
    long long behind(int first, int last, int* tip) const {
        const long long right = x[last] - x[first], forward = y[last] - y[first];
        const bool faces = right * y[first] - forward * x[first] >= 0;
        // Key by which points are compared, smallest first: larger areas first, then the first point.
        unsigned long long best = ~0ull;
        for (int k = first + 1 + warp.lane; k <= last; k += warp.size) {
            const long long area = right * (y[k] - y[first]) - forward * (x[k] - x[first]);
            const long long away = faces ? area : -area;
            const unsigned long long key = (unsigned long long)(MOST_AREA - away) << POINT_BITS | k;
            if (away > 0 && key < best) best = key;
        }
        best = warp.min(best);
        *tip = best == ~0ull ? first : (int)(best & ((1 << POINT_BITS) - 1));
        return best == ~0ull ? 0 : MOST_AREA - (long long)(best >> POINT_BITS);
    }

    // Returns the index of the point at which the contour is split, -1 if it is not split.
    int corner(int first, int last) const {
        if (last - first < FEWEST - 1) return -1;
        int at;
        const long long area = behind(first, last, &at);
        bool smooth = true;
        const int from = at < 2 ? 0 : at - 2, to = at + 2 < points - 1 ? at + 2 : points - 1;
        for (int k = from; k < to; ++k) smooth &= squared(k, k + 1) <= jump * jump;
        const long long most = (smooth ? bend : FAR_BEHIND * bend) * length(first, last);
        const bool is_long = squared(first, at) >= shortest * shortest &&
                             squared(last, at) >= shortest * shortest;
        return area > most && is_long ? at : -1;
    }

    // Splits the contour; returns the number of parts.
    int run() const {
        parts[0] = 0;
        if (points < FEWEST) return 1;
        int count = 0, waiting = 0, first = 0;
        stack[waiting++] = points - 1;
        while (waiting) {
            const int last = stack[waiting - 1], at = corner(first, last);
            if (at >= 0) {
                stack[waiting++] = at;
            } else {
                parts[count++] = first;
                first = last;
                --waiting;
            }
        }
        parts[count] = points - 1;
        int merged = 1, tip;
        for (int place = 1; place < count; ++place) {
            const int begin = parts[merged - 1], end = parts[place + 1];
            const long long area = behind(begin, end, &tip);
            if (area > bend * length(begin, end)) parts[merged++] = parts[place];
        }
        return merged;
    }
};

} }  // namespace jaxdet
