// Hysteresis, the last step of Canny: keeps weak edges that are 8-connected to strong ones. Twin of
// `_connected_to` in jaxdet/reference/paper/_canny.py. The images are bitmaps, see pixel_bits.h.
#pragma once
#include "pixel_bits.h"

namespace jaxdet { namespace {

struct Hysteresis {
    typedef unsigned long long Word;

    int height, words;  // rows, and 64-bit words per row
    const Word* weak;   // (height, words): weak edges
    Word* edges;        // (height, words): strong edges; result: all edges connected to them

    // Grows the edges until nothing changes. A thread sweeps down and up a column of words in a strip
    // of rows, so that it can follow lines.
    void run(const Team& team) const {
        const int strips = team.size > words ? team.size / words : 1;
        const int rows = (height + strips - 1) / strips;
        for (bool grown = true; team.any(grown);) {
            grown = false;
            for (int i = team.rank; i < strips * words; i += team.size) {
                const int w = i % words, first = i / words * rows;
                const int end = first + rows < height ? first + rows : height;
                for (int y = first; y < end; ++y) grown |= grow(y, w);
                for (int y = end - 1; y >= first; --y) grown |= grow(y, w);
            }
        }
    }

    // Adds the runs of weak pixels in a word that touch an edge; returns whether there are any.
    bool grow(int y, int w) const {
        const int i = y * words + w;
        Word free = weak[i] & ~edges[i];
        if (!free) return false;
        Word near = 0;
        for (int row = y - 1; row <= y + 1; ++row) {
            if (row < 0 || row >= height) continue;
            const Word* at = edges + row * words + w;
            near |= at[0] | at[0] << 1 | at[0] >> 1;
            if (w > 0) near |= at[-1] >> 63;
            if (w + 1 < words) near |= at[1] << 63;
        }
        Word now = near & free;
        if (!now) return false;
        // The carry of a seed added to its run of ones propagates to the end of the run.
        now |= free & ~(free + now);
        for (int step = 1; step < 64; step *= 2) {
            now |= free & now >> step;
            free &= free >> step;
        }
        edges[i] |= now;
        return true;
    }
};

} }  // namespace jaxdet
