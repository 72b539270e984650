// An image of bytes as bits.
#pragma once
#include "pixel_bits.h"
#include "vectors.h"

struct MaskBits {
    typedef unsigned long long Word;

    Team team;
    int height, width;
    const bool* mask;    // (height, width)
    unsigned* bits_out;  // (height, PixelBits::words(width))

    void run() const {
        const int words = PixelBits::words(width);
#if defined(__CUDA_ARCH__)
        // A word a thread.
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
#else
        for (int y = 0; y < height; ++y) {
            const unsigned char* row = (const unsigned char*)mask + (size_t)y * width;
            Word* out = (Word*)bits_out + (size_t)y * words / 2;
            for (int w = 0; w < words / 2; ++w) {
                const int x = w * Vectors::BYTES;
                if (x + Vectors::BYTES <= width) {
                    out[w] = Vectors::bits(*(const Vectors::Bytes*)(row + x));
                    continue;
                }
                Word bits = 0;
                for (int i = 0; i < width - x; ++i) bits |= (Word)(row[x + i] != 0) << i;
                out[w] = bits;
            }
        }
#endif
    }
};
