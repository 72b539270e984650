// The lines of a PNG: their filters undone, and their samples written as pixels.
//
// Source: Portable Network Graphics Specification, Section 9 (filtering). A line is the number of
// its filter and the bytes of its samples, of two bytes the higher first.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct PngLines {
    enum { NONE, SUB, UP, AVERAGE, PAETH };

    unsigned char* lines;  // (height, 1 + bytes)
    int height, bytes;
    int step;  // bytes of a pixel: 1, 2, 3, 4, 6 or 8

    // The highest byte of three samples `spread` bytes apart; 0 for grey.
    void color(int spread, unsigned char* rgb_out) {
        const int width = bytes / step;
        for (int v = 0; v < height; ++v, rgb_out += 3 * width) {
            const unsigned char* line = undone(v);
            if (step == 3)
                for (int i = 0; i < bytes; ++i) rgb_out[i] = line[i];
            else
                for (int u = 0; u < width; ++u)
                    for (int k = 0; k < 3; ++k) rgb_out[3 * u + k] = line[step * u + spread * k];
        }
    }

    // The samples of a line; those above it are undone already.
    unsigned char* undone(int v) {
        unsigned char* line = lines + (size_t)v * (1 + bytes) + 1;
        // Inlined with a constant step, so that the pixel to the left stays in registers.
        if (step == 1) undo(line, v > 0, 1);
        else if (step == 2) undo(line, v > 0, 2);
        else if (step == 3) undo(line, v > 0, 3);
        else if (step == 4) undo(line, v > 0, 4);
        else if (step == 6) undo(line, v > 0, 6);
        else undo(line, v > 0, 8);
        return line;
    }

    // The line above the first counts as zeros.
    __attribute__((always_inline)) void undo(unsigned char* line, bool has_above, const int step) {
        const unsigned char* above = line - 1 - bytes;
        const int filter = line[-1];
        if (filter == SUB || (filter == PAETH && !has_above)) sub(line, step, 0);
        else if (filter == UP && has_above) up(line, above);
        else if (filter == AVERAGE && has_above) average(line, above, step);
        else if (filter == AVERAGE) sub(line, step, 1);
        else if (filter == PAETH) paeth(line, above, step);
    }

    // Adds the pixel to the left, or half of it: `shift` 0 or 1.
    __attribute__((always_inline)) void sub(unsigned char* line, const int step, const int shift) {
        unsigned char left[8] = {};
        for (int i = 0; i < bytes; i += step)
            for (int k = 0; k < step; ++k) left[k] = line[i + k] += left[k] >> shift;
    }

    void up(unsigned char* line, const unsigned char* above) {
        for (int i = 0; i < bytes; ++i) line[i] += above[i];
    }

    __attribute__((always_inline)) void average(unsigned char* line, const unsigned char* above, const int step) {
        unsigned char left[8] = {};
        for (int i = 0; i < bytes; i += step)
            for (int k = 0; k < step; ++k)
                left[k] = line[i + k] += (left[k] + above[i + k]) >> 1;
    }

    // Adds that of left, above and the corner which is nearest to left + above - corner, of equally
    // near ones the first. With bound = 3 corner - left - above that is the lower of left and above
    // where both are at most bound, the higher where both are at least bound, else the corner:
    // a chain of fewer steps from pixel to pixel than the three distances.
    __attribute__((always_inline)) void paeth(unsigned char* line, const unsigned char* above, const int step) {
        int left[8] = {}, corner[8] = {};
        for (int i = 0; i < bytes; i += step)
            for (int k = 0; k < step; ++k) {
                const int a = left[k], b = above[i + k], c = corner[k];
                const int low = a < b ? a : b, high = a < b ? b : a, bound = 3 * c - a - b;
                const int not_high = high <= bound ? low : c;
                const int nearest = bound <= low ? high : not_high;
                left[k] = line[i + k] = (unsigned char)(line[i + k] + nearest);
                corner[k] = b;
            }
    }
};

} }  // namespace jaxdet
