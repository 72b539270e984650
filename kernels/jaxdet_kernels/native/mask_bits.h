// An image of bytes as bits.
#pragma once
#include "pixel_bits.h"

struct MaskBits {
    typedef unsigned long long Word;

    Team team;
    int height, width;
    const bool* mask;    // (height, width)
    unsigned* bits_out;  // (height, PixelBits::words(width))

    void run() const {
        const int words = PixelBits::words(width);
        for (int i = team.rank; i < height * words; i += team.size) {
            const int y = i / words, x = (i - y * words) * 32;
            const bool* from = mask + (size_t)y * width + x;
            unsigned bits = 0;
            if (x + 32 <= width && (size_t)from % sizeof(Word) == 0) {
                for (int k = 0; k < 4; ++k)
                    bits |= PixelBits::packed(Team::input((const Word*)from + k)) << 8 * k;
            } else {
                for (int k = 0; k < 32 && x + k < width; ++k) bits |= (unsigned)from[k] << k;
            }
            bits_out[i] = bits;
        }
    }
};
