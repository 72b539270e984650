// The strongest corners of a frame on the CPU, by a thread: from its colours on. On CUDA the steps are
// kernels of their own.
#pragma once
#include "canny.h"
#include "corner_maxima.h"
#include "corner_selection.h"
#include "corner_settings.h"
#include "hysteresis.h"

#if !defined(__CUDA_ARCH__)
struct Corners {
    typedef unsigned long long Key;

    const unsigned char* color;  // (height, width, 3), RGB.
    const unsigned* allowed;     // (height, PixelBits::words(width))
    int height, width;
    CornerSettings given;
    int slots;
    int *u_out, *v_out;          // (slots), zero where there is no corner.
    unsigned* scratch;           // Two lists of keys, as long as the image, and four images of bits.

    // How many corners there are, at most one more than slots.
    int run() const {
        const size_t bits = (size_t)height * PixelBits::words(width);
        const size_t pixels = (size_t)height * width;
        Key *list = (Key*)scratch, *other = list + pixels;
        unsigned *weak = (unsigned*)(other + pixels), *strong = weak + bits;
        unsigned *edges = strong + bits, *blocked = edges + bits;
        CannySuppress{color, height, width, given.low(), given.high(), weak, strong}.run();
        Hysteresis{Team(0, 0), height, width, weak, strong, edges}.run();
        const int count = CornerMaxima{edges, allowed, given.everywhere(), height, width,
                                       given.quality(), list}.run();
        return CornerSelection{height, width, CornerDisk{given.limit()}, slots, list, other, count,
                               blocked, u_out, v_out}.run();
    }
};
#endif
