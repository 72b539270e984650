// Where a contour bends around free floor. Twin of `straight_parts` in
// jaxdet/reference/_outlines.py. Lanes work on one contour together: all of them take every step, and
// share the search for the largest triangle.
#pragma once
#include "lanes.h"

struct StraightParts {
    enum { FAR_BEHIND = 4, FEWEST = 5 };
    const Lanes& lanes;
    const int *x, *y;  // the contour, from left to right
    int points;
    long long bend, shortest, jump;
    // Scratch, a word a point; result, one more: the first point of each part. Each lane reads what
    // it has written itself, the same as all others.
    int *stack, *parts;

    long long squared(int a, int b) const {
        const long long right = x[b] - x[a], forward = y[b] - y[a];
        return right * right + forward * forward;
    }

    // The integer square root, at least 1.
    long long root(long long square) const {
        long long left = square, found = 0, bit = 1ll << 42;
        while (bit > square) bit >>= 2;
        for (; bit; bit >>= 2) {
            const bool fits = left >= found + bit;
            left -= fits ? found + bit : 0;
            found = (found >> 1) + (fits ? bit : 0);
        }
        return found > 1 ? found : 1;
    }

    // Twice the area of the largest triangle behind the chord of two points, and where its tip is.
    long long behind(int first, int last, int* tip) const {
        const long long right = x[last] - x[first], forward = y[last] - y[first];
        const bool faces = right * y[first] - forward * x[first] >= 0;
        long long largest = 0;
        *tip = first;
        for (int k = first + 1 + lanes.rank; k <= last; k += lanes.size) {
            const long long area = right * (y[k] - y[first]) - forward * (x[k] - x[first]);
            const long long away = faces ? area : -area;
            if (away > largest) largest = away, *tip = k;
        }
#if defined(__CUDA_ARCH__)
        for (int away = Lanes::size / 2; away; away /= 2) {
            const long long other = __shfl_xor_sync(0xffffffff, largest, away);
            const int at = __shfl_xor_sync(0xffffffff, *tip, away);
            if (other > largest || (other == largest && at < *tip)) largest = other, *tip = at;
        }
#endif
        return largest;
    }

    // The point to split at, -1 for none.
    int corner(int first, int last) const {
        if (last - first < FEWEST - 1) return -1;
        int at;
        const long long area = behind(first, last, &at);
        bool smooth = true;
        const int from = at < 2 ? 0 : at - 2, to = at + 2 < points - 1 ? at + 2 : points - 1;
        for (int k = from; k < to; ++k) smooth &= squared(k, k + 1) <= jump * jump;
        const long long most = (smooth ? bend : FAR_BEHIND * bend) * root(squared(first, last));
        const bool is_long = squared(first, at) >= shortest * shortest &&
                             squared(last, at) >= shortest * shortest;
        return area > most && is_long ? at : -1;
    }

    // How many parts there are.
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
            if (area > bend * root(squared(begin, end))) parts[merged++] = parts[place];
        }
        return merged;
    }
};
