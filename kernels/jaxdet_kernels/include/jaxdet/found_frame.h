// Floor frame of the detected floor, or the fallback if the floor was refused. Twin of `axes` in
// jaxdet/floor/frame.py and of `slopes` in jaxdet/floor/units.py.
#pragma once
#include "floor_frame.h"
#include "floor_planes.h"

namespace jaxdet { namespace {

struct FoundFrame {
    // Indices of the results of `Floor`.
    enum { PITCH, ROLL, HEIGHT, START, TURN, ON, ALL, REFUSED, RESULTS };
    FloorAngles angles;

    // Wraps an angle to [-180, 180) degrees.
    static int within_a_turn(int angle) {
        enum { HALF = 180 * FloorAngles::ANGLES, WHOLE = 2 * HALF };
        const int rest = (angle + HALF) % WHOLE;
        return (rest < 0 ? rest + WHOLE : rest) - HALF;
    }

    static int product(int a, int b) {
        const int bits = 2 * FloorAngles::SINE_BITS - FloorFrame::BITS;
        return (a * b + (1 << (bits - 1))) >> bits;
    }

    // Writes the frame of the floor `found` (RESULTS values) to `out`, or `given` if no floor was
    // accepted; both have FloorFrame::VALUES values.
    void run(const int* found, const int* given, int* out) const {
        if (found[REFUSED]) {
            for (int i = 0; i < FloorFrame::VALUES; ++i) out[i] = given[i];
            return;
        }
        const int pitch = within_a_turn(found[PITCH]), roll = within_a_turn(found[ROLL]);
        const int sin_p = angles.sine(pitch), cos_p = angles.cosine(pitch);
        const int sin_r = angles.sine(roll), cos_r = angles.cosine(roll);
        const int one = 1 << FloorAngles::SINE_BITS, turn = found[TURN];
        const int shift = FloorAngles::SLOPE_BITS - FloorFrame::BITS;
        const int slope = (angles.slope(turn) + (1 << (shift - 1))) >> shift;
        const int values[FloorFrame::VALUES] = {
            product(cos_r, one), product(-sin_r, one), 0,
            product(-sin_r, sin_p), product(-cos_r, sin_p), product(cos_p, one),
            product(sin_r, cos_p), product(cos_r, cos_p), product(sin_p, one),
            found[HEIGHT], 1, turn ? found[START] : 0, turn ? slope : 0,
        };
        for (int i = 0; i < FloorFrame::VALUES; ++i) out[i] = values[i];
    }
};

} }  // namespace jaxdet
