// The strongest corners of a frame on the CPU, by a thread: from its colours on. On CUDA the steps are
// kernels of their own.
#pragma once
#include "canny.h"
#include "corner_maxima.h"
#include "corner_selection.h"
#include "corner_settings.h"
#include "hysteresis.h"

namespace jaxdet { namespace {

#if !defined(__CUDA_ARCH__)
struct Corners {
    typedef unsigned long long Key;

    const unsigned char* color;  // (height, width, 3), RGB.
    const unsigned* allowed;     // (height, PixelBits::words(width))
    int height, width;
    CornerSettings given;
    int slots;
    int *u_out, *v_out;          // (slots), zero where there is no corner.
    // Two lists of keys, as long as the image, two images of bits for the hysteresis and two more.
    unsigned* scratch;

    // How many corners there are, at most one more than slots.
    int run() const {
        const size_t bits = (size_t)height * PixelBits::words(width);
        const size_t pixels = (size_t)height * width;
        Key *list = (Key*)scratch, *other = list + pixels;
        const int stride = 2 * Hysteresis::stride(width);
        const size_t spaced = Hysteresis::spaced(height, width);
        Key* weak = Hysteresis::rows(other + pixels, height, width);
        Key* strong = Hysteresis::rows(other + pixels + spaced, height, width);
        unsigned *edges = (unsigned*)(other + pixels + 2 * spaced), *blocked = edges + bits;
        CannySuppress{color, height, width, given.low(), given.high(), stride,
                      (unsigned*)weak, (unsigned*)strong}.run();
        Hysteresis{height, width, weak, strong, edges}.run();
        const int count = CornerMaxima{edges, allowed, given.everywhere(), height, width,
                                       given.quality(), list}.run();
        return CornerSelection{height, width, CornerDisk{given.limit()}, slots, list, other, count,
                               blocked, u_out, v_out}.run();
    }
};
#endif

} }  // namespace jaxdet
