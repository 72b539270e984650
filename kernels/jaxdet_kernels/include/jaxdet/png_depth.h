// Decoding of the filtered lines of a 16-bit grey PNG, sixteen lines at a time.
//
// Source: Portable Network Graphics Specification, Section 9 (filtering). A line is the number of its
// filter followed by the bytes of its samples, high byte first.
//
// A byte depends on the bytes to its left (a), above (b) and above left (c). So each line is processed
// one pixel behind the line above, and a step needs only the bytes of the step before: a is the same
// lane, b the preceding lane, and c the previous b. All filters are one expression, in which inputs
// that a filter does not use are masked: with a only, Paeth's predictor is a; with b only, it is b.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct PngDepth {
    enum { NONE, SUB, UP, AVERAGE, PAETH };
    enum { LINES = 16 };
    typedef unsigned short Pixels __attribute__((vector_size(32), aligned(2), may_alias));
    typedef short Lanes __attribute__((vector_size(64)));  // high bytes of the lines, then low bytes

    const unsigned char* lines;  // (height, 1 + 2 width) filtered lines
    int height, width;
    unsigned short* depth_out;  // (height, width) decoded depth

    void run() const {
        for (int v = 0; v < height; v += LINES) undo(v, height - v < LINES ? height - v : LINES);
    }

    // Decodes `count` lines, from line v on.
    void undo(int v, int count) const {
        Lanes left = {}, above = {}, corner = {}, mean = {};  // -1: the filter uses the input
        for (int r = 0; r < count; ++r) {
            const int filter = *line(v + r);
            const bool has_above = v + r > 0;  // otherwise the line above counts as zeros
            for (int lane = r; lane < 2 * LINES; lane += LINES) {
                left[lane] = -(filter == SUB || filter >= AVERAGE);
                above[lane] = -(has_above && filter >= UP);
                corner[lane] = -(has_above && filter == PAETH);
                mean[lane] = -(filter == AVERAGE);
            }
        }
        Lanes bytes = {}, before = {};  // bytes of the last step, and the bytes above them
        for (int u = 0; u < width + count - 1; u += LINES) {
            // Lane r processes column u - r of its line; pixels outside the image count as zeros.
            const bool inside = u >= LINES && u + LINES <= width && count == LINES;
            Pixels pixels[LINES] = {}, last = {};
            if (inside)
                for (int r = 0; r < LINES; ++r)
                    __builtin_memcpy(&pixels[r], line(v + r) + 1 + 2 * (u - r), sizeof(Pixels));
            else
                for (int r = 0; r < count; ++r) read(line(v + r) + 1, u - r, &pixels[r]);
            if (v > 0) read((const unsigned char*)(depth_out + (size_t)(v - 1) * width), u, &last);
            transpose(pixels);
            for (int k = 0; k < LINES; ++k) {
                Lanes first = {};
                first[LINES - 1] = last[k] >> 8;
                first[2 * LINES - 1] = last[k] & 255;
                Lanes up, filtered, nearest;
                lower(bytes, first, &up);
                split(pixels[k], &filtered);
                const Lanes a = bytes & left, b = up & above, c = before & corner;
                paeth(a, b, c, &nearest);
                bytes = (filtered + (mean ? (a + b) >> 1 : nearest)) & 255;
                before = up;
                join(bytes, &pixels[k]);
            }
            transpose(pixels);
            unsigned short* to = depth_out + (size_t)v * width + u;
            if (inside)
                for (int r = 0; r < LINES; ++r, to += width - 1) *(Pixels*)to = pixels[r];
            else
                for (int r = 0; r < count; ++r) write(pixels[r], v + r, u - r);
        }
    }

    const unsigned char* line(int v) const { return lines + (size_t)v * (1 + 2 * width); }

    // Reads or writes the pixels of a line beginning at column u.
    void read(const unsigned char* from, int u, Pixels* out) const {
        for (int k = u < 0 ? -u : 0; k < LINES && u + k < width; ++k)
            __builtin_memcpy((char*)out + 2 * k, from + 2 * (u + k), 2);
    }
    void write(const Pixels& pixels, int v, int u) const {
        for (int k = u < 0 ? -u : 0; k < LINES && u + k < width; ++k)
            depth_out[(size_t)v * width + u + k] = pixels[k];
    }

    // Paeth's predictor: the value among a, b and c that is nearest to a + b - c; in a tie the first.
    // With bound = 3 c - a - b it is min(a, b) if both are at most bound, max(a, b) if both are at
    // least bound, otherwise c, which has a shorter dependency chain than comparing three distances.
    __attribute__((always_inline)) static void paeth(const Lanes& a, const Lanes& b, const Lanes& c,
                                                     Lanes* out) {
        const Lanes low = a < b ? a : b, high = a < b ? b : a, bound = 3 * c - (a + b);
        const Lanes not_high = high <= bound ? low : c;
        *out = bound <= low ? high : not_high;
    }

    // Shifts the lanes, so that each line gets the bytes of the line above, and the first line the last
    // lanes of `first`.
    __attribute__((always_inline)) static void lower(const Lanes& bytes, const Lanes& first,
                                                     Lanes* out) {
        *out = __builtin_shufflevector(first, bytes, 15, 32, 33, 34, 35, 36, 37, 38, 39, 40, 41, 42, 43,
                                       44, 45, 46, 31, 48, 49, 50, 51, 52, 53, 54, 55, 56, 57, 58, 59,
                                       60, 61, 62);
    }

    // Splits pixels in file byte order into high and low bytes, or joins them.
    __attribute__((always_inline)) static void split(const Pixels& pixels, Lanes* out) {
        const Pixels high = pixels & 255, low = pixels >> 8;
        *out = (Lanes)__builtin_shufflevector(high, low, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13,
                                              14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27,
                                              28, 29, 30, 31);
    }
    __attribute__((always_inline)) static void join(const Lanes& bytes, Pixels* out) {
        const Pixels high = (Pixels)__builtin_shufflevector(bytes, bytes, 0, 1, 2, 3, 4, 5, 6, 7, 8,
                                                            9, 10, 11, 12, 13, 14, 15);
        const Pixels low = (Pixels)__builtin_shufflevector(bytes, bytes, 16, 17, 18, 19, 20, 21, 22,
                                                           23, 24, 25, 26, 27, 28, 29, 30, 31);
        *out = high << 8 | low;
    }

    // Transposes by rounds that interleave rows i and i + LINES / 2.
    __attribute__((always_inline)) static void transpose(Pixels* rows) {
        for (int round = LINES; round > 1; round /= 2) {
            Pixels next[LINES];
            for (int i = 0; i < LINES / 2; ++i) {
                const Pixels a = rows[i], b = rows[i + LINES / 2];
                next[2 * i] = __builtin_shufflevector(a, b, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21,
                                                      6, 22, 7, 23);
                next[2 * i + 1] = __builtin_shufflevector(a, b, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28,
                                                          13, 29, 14, 30, 15, 31);
            }
            for (int i = 0; i < LINES; ++i) rows[i] = next[i];
        }
    }
};

} }  // namespace jaxdet
