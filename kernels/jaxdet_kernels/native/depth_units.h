// Metres as whole depth units. Twin of `metres_to_units` in the tests of images.
#pragma once
#include "team.h"

struct DepthUnits {
    double unit_m;

    // The nearest unit, halves to even; 0 where it is not of 1 to 65535.
    unsigned short of(float metres) const {
        const double units = __builtin_rint(metres / unit_m);
        return (unsigned short)(units > 0 && units <= 65535 ? (int)units : 0);
    }
};
