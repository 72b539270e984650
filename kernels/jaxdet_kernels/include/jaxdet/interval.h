// Intervals of floats. Rounding never swaps two numbers, so an operation on the ends of intervals
// bounds the rounded results of that operation on all numbers inside of them.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct Interval {
    float low, high;

    Interval(float value) : low(value), high(value) {}
    Interval(float low, float high) : low(low), high(high) {}

    friend Interval operator+(Interval a, Interval b) { return {a.low + b.low, a.high + b.high}; }
    friend Interval operator*(Interval a, Interval b) {
        const float p = a.low * b.low, q = a.low * b.high, r = a.high * b.low, s = a.high * b.high;
        return {lower(lower(p, q), lower(r, s)), higher(higher(p, q), higher(r, s))};
    }
    // Anything if the divisor may be about 0 or less. No end is infinite, as 0 times infinity is not
    // a number.
    friend Interval operator/(Interval a, Interval b) {
        if (!(b.low > 1e-6f)) return {-1e12f, 1e12f};
        return {a.low / (a.low < 0 ? b.low : b.high), a.high / (a.high < 0 ? b.high : b.low)};
    }

private:
    static float lower(float a, float b) { return a < b ? a : b; }
    static float higher(float a, float b) { return a > b ? a : b; }
};

} }  // namespace jaxdet
