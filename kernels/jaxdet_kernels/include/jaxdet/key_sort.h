// Sorts distinct 64-bit keys in descending order: a bitonic network on CUDA, a radix sort on the CPU.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct KeySort {
    typedef unsigned long long Key;

    // `other` is scratch memory of the same length as `keys`. Ends in a sync.
#if defined(__CUDA_ARCH__)
    static void run(const Team& team, Key* keys, Key*, int count) {
        for (int run = 2; run < 2 * count; run *= 2)
            // The first exchange of a run pairs mirrored positions, so that all exchanges have the same
            // direction and positions beyond the last key need not exist.
            for (int mask = run - 1, away = run / 2; away; away /= 2, mask = away) {
                for (int i = team.rank; i < count; i += team.size) {
                    const int partner = i ^ mask;
                    if (partner <= i || partner >= count || keys[i] > keys[partner]) continue;
                    const Key swap = keys[i];
                    keys[i] = keys[partner];
                    keys[partner] = swap;
                }
                team.sync();
            }
    }
#else
    static void run(const Team&, Key* keys, Key* other, int count) {
        enum { BITS = 8, BINS = 1 << BITS };
        Key differ = 0, *from = keys, *to = other;
        for (int i = 1; i < count; ++i) differ |= keys[i] ^ keys[0];
        for (int shift = 0; shift < 64 && differ >> shift; shift += BITS) {
            if (!(differ >> shift & (BINS - 1))) continue;
            int bins[BINS + 1] = {};
            // Bin BINS - 1 - digit, for descending order.
            for (int i = 0; i < count; ++i) ++bins[BINS - (from[i] >> shift & (BINS - 1))];
            for (int i = 1; i < BINS; ++i) bins[i] += bins[i - 1];
            for (int i = 0; i < count; ++i)
                to[bins[BINS - 1 - (from[i] >> shift & (BINS - 1))]++] = from[i];
            Key* const swap = from;
            from = to;
            to = swap;
        }
        if (from != keys)
            for (int i = 0; i < count; ++i) keys[i] = from[i];
    }
#endif
};

} }  // namespace jaxdet
