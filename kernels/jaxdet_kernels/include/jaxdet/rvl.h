// Decoder of RVL, run-length and variable-length coding of depth images. Source: A. Wilson, Fast
// Lossless Depth Image Compression, ISS 2017.
//
// A number is a sequence of nibbles with three bits each, lowest first; the top bit of a nibble is set
// if more nibbles follow. Nibbles are packed in little-endian 32-bit words, most significant first.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

// Lookup table by the next three nibbles: most differences between pixels are one or two nibbles long.
struct RvlWindows {
    enum { BITS = 12, REACH = 256 };

    struct Window {
        short sum[3];  // prefix sums of the complete differences, the last one repeated
        unsigned char count;  // number of complete differences
        unsigned char bits;   // number of bits of the complete differences
    };
    Window windows[1 << BITS];  // no partial sum exceeds REACH in magnitude

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

// Bit reader of the stream, with the next nibble at the top of a register; it reads zeros after the end.
struct RvlNibbles {
    const unsigned char* words;
    long long count;     // number of words
    long long next = 0;  // index of the next word
    unsigned long long bits = 0;
    int held = 0;        // number of bits in the register

    // Refills the register to at least 33 bits.
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

    // Whether more bits were read than the stream has.
    bool overrun() const { return 32 * next - held > 32 * count; }

    // Reads the next number; -1 if it is longer than 32 bits.
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
    long long size;  // number of pixels of the image
    RvlWindows table;

    // Decodes alternating runs of zeros and of other pixels until the image is full; returns the status.
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

    // Decodes up to three pixels at once. Returns false, without a change, if a value might leave the range
    // of 16 bits, or if no difference is complete in the next three nibbles.
    bool window(long long& at, long long& value) {
        const RvlWindows::Window& next = table.windows[nibbles.bits >> (64 - RvlWindows::BITS)];
        if (!next.count || value < RvlWindows::REACH || value > MOST - RvlWindows::REACH)
            return false;
        // Pixels beyond the count are overwritten later.
        for (int i = 0; i < 3; ++i) pixels_out[at + i] = (unsigned short)(value + next.sum[i]);
        value += next.sum[2];
        at += next.count;
        nibbles.drop(next.bits);
        return true;
    }
};

} }  // namespace jaxdet
