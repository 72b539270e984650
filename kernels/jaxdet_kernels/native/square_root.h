// Square roots of integers below 2^44, rounded down.
#pragma once
#include "team.h"

struct SquareRoot {
    static int of(unsigned long long square) {
        unsigned long long left = square, found = 0, bit = 1ull << 42;
        while (bit > square) bit >>= 2;
        for (; bit; bit >>= 2) {
            const bool fits = left >= found + bit;
            left -= fits ? found + bit : 0;
            found = (found >> 1) + (fits ? bit : 0);
        }
        return (int)found;
    }
};
