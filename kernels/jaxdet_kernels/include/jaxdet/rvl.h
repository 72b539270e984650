// RVL: depth as variable-length numbers. Source: A. Wilson, Fast Lossless Depth Image Compression,
// ISS 2017.
//
// A number is a run of nibbles, three bits in each, the lowest first; the top bit of a nibble says
// that more follow. Nibbles stand in little-endian 32-bit words, the most significant first.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

// What the next three nibbles hold: most differences between pixels are one or two long.
struct RvlWindows {
    enum { BITS = 12, REACH = 256 };

    struct Window {
        short sum[3];  // of the differences up to each number; the last again where it is not there
        unsigned char count;  // of numbers that end here
        unsigned char bits;   // of these
    };
    Window windows[1 << BITS];  // no sum is beyond REACH

    RvlWindows() {
        for (int code = 0; code < 1 << BITS; ++code) {
            Window& window = windows[code];
            int number = 0, place = 0, sum = 0;
            window.count = window.bits = 0;
            for (int shift = BITS - 4; shift >= 0; shift -= 4) {
                const int nibble = code >> shift & 15;
                number |= (nibble & 7) << place;
                place += 3;
                if (nibble >= 8) continue;
                sum += number >> 1 ^ -(number & 1);
                window.sum[window.count++] = (short)sum;
                window.bits = (unsigned char)(BITS - shift);
                number = place = 0;
            }
            for (int i = window.count; i < 3; ++i) window.sum[i] = (short)sum;
        }
    }
};

// The stream's nibbles, the next at the top of a register; zeros after its end.
struct RvlNibbles {
    const unsigned char* words;
    long long count;  // words
    long long next;
    unsigned long long bits;
    int held;  // bits of the stream in the register

    RvlNibbles(const unsigned char* words, long long count)
        : words(words), count(count), next(0), bits(0), held(0) {}

    // At least 33 bits are held afterwards.
    void refill() {
        if (held > 32) return;
        unsigned word = 0;
        if (next < count) {
            const unsigned char* byte = words + 4 * next;
            word = byte[0] | byte[1] << 8 | byte[2] << 16 | (unsigned)byte[3] << 24;
        }
        bits |= (unsigned long long)word << (32 - held);
        held += 32;
        ++next;
    }

    void drop(int size) {
        bits <<= size;
        held -= size;
    }

    // Whether more was taken than there is.
    bool overrun() const { return 32 * next - held > 32 * count; }

    // The next number; -1 where it is longer than 32 bits.
    long long number() {
        long long value = 0;
        for (int place = 0; place < 33; place += 3) {
            refill();
            const unsigned long long nibble = bits >> 60;
            drop(4);
            value |= (long long)(nibble & 7) << place;
            if (nibble < 8) return value;
        }
        return -1;
    }
};

struct RvlDecoder {
    enum { GOOD, SHORT, OUTSIDE, LONG_NUMBER, LARGE_VALUE, MOST = 0xffff };

    RvlNibbles nibbles;
    unsigned short* pixels_out;
    long long size;  // of the image [pixel]
    RvlWindows table;

    // Runs of zeros and of other pixels in turns until the image is full.
    int run() {
        long long at = 0, value = 0;
        while (at < size) {
            const long long zeros = nibbles.number(), filled = nibbles.number();
            if (nibbles.overrun()) return SHORT;
            if (zeros < 0 || filled < 0) return LONG_NUMBER;
            if (zeros + filled == 0 || zeros + filled > size - at) return OUTSIDE;
            for (const long long end = at + zeros; at < end; ++at) pixels_out[at] = 0;
            for (const long long end = at + filled; at < end;) {
                nibbles.refill();
                if (at + 6 <= end && window(at, value) && window(at, value)) continue;
                const long long code = nibbles.number();
                if (code < 0) return LONG_NUMBER;
                value += code >> 1 ^ -(code & 1);
                if (value < 0 || value > MOST) return LARGE_VALUE;
                pixels_out[at++] = (unsigned short)value;
            }
            if (nibbles.overrun()) return SHORT;
        }
        return GOOD;
    }

    // Up to three pixels at once, where none can leave 16 bits; false where no number ends so soon.
    bool window(long long& at, long long& value) {
        const RvlWindows::Window& next = table.windows[nibbles.bits >> (64 - RvlWindows::BITS)];
        if (!next.count || value < RvlWindows::REACH || value > MOST - RvlWindows::REACH)
            return false;
        // Those beyond the count are written again.
        for (int i = 0; i < 3; ++i) pixels_out[at + i] = (unsigned short)(value + next.sum[i]);
        value += next.sum[2];
        at += next.count;
        nibbles.drop(next.bits);
        return true;
    }
};

} }  // namespace jaxdet
