// Greedy non-maximum suppression of corners by a minimum distance. Twin of `_without_near` in
// jaxdet/reference/paper/_corners.py: in order of decreasing strength (equal corners in reverse raster
// order), a corner is accepted unless an accepted corner is closer than the distance.
#pragma once
#include "pixel_bits.h"
#include "square_root.h"
#include "team.h"
#include "warp.h"

namespace jaxdet { namespace {

// Sorts distinct 64-bit keys in descending order: a bitonic network on CUDA, a radix sort on the CPU.
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

struct CornerSelection {
    typedef unsigned long long Key;  // strength << 32 | place

    int height, width;
    int limit;            // square of the minimum distance, rounded up; 0: no minimum
    int slots;
    int *u_out, *v_out;   // (slots) columns and rows, 0 in unused slots
    // Scratch memory.
    unsigned* blocked;    // (height, PixelBits::words(width)) pixels close to an accepted corner
    // (height) half-width of the disk by vertical distance from its centre; -1: outside
    int* halves;
    Key* other;           // (count) memory for sorting keys

    // Selects corners; returns their number, at most slots + 1. One warp selects.
    int run(const Team& team, Key* keys, int count) const {
        const int words = PixelBits::words(width);
        for (int i = team.rank; i < height * words; i += team.size) blocked[i] = 0;
        for (int dy = team.rank; dy < height; dy += team.size) halves[dy] = half(dy);
        for (int i = team.rank; i < slots; i += team.size) u_out[i] = v_out[i] = 0;
        team.sync();
        KeySort::run(team, keys, other, count);
        const Warp warp(team);
        const int taken = warp.index == 0 ? take(warp, keys, count) : 0;
        team.sync();
        return taken;
    }

    // Half-width of the disk of pixels whose squared distance, an integer, is below the limit.
    int half(int dy) const {
        const int left = limit - dy * dy;
        if (left <= 0) return -1;
        int side = (int)SquareRoot::rounded((float)left);
        while (side > 0 && side * side >= left) --side;
        while ((side + 1) * (side + 1) < left) ++side;
        return side;
    }

    // A warp tests one corner per lane, accepts the first that is not blocked, and tests the others
    // again.
    int take(const Warp& warp, const Key* keys, int count) const {
        int taken = 0;
        for (int start = 0; start < count && taken <= slots; start += warp.size) {
            const int i = start + warp.lane, place = i < count ? (int)(unsigned)keys[i] : 0;
            unsigned open = warp.ballot(i < count && is_open(place));
            while (open && taken <= slots) {
                const int first = BitRows::lowest(open);
                const int corner = warp.broadcast(place, first);
                if (taken < slots && warp.lane == 0) {
                    u_out[taken] = PixelBits::column(corner);
                    v_out[taken] = PixelBits::row(corner);
                }
                ++taken;
                block(warp, corner);
                open = warp.ballot(open >> warp.lane & 1 && warp.lane > first && is_open(place));
            }
        }
        return taken;
    }

    bool is_open(int place) const {
        const int x = PixelBits::column(place), y = PixelBits::row(place);
        return !(blocked[y * PixelBits::words(width) + x / 32] >> (x % 32) & 1);
    }

    void block(const Warp& warp, int place) const {
        const int x = PixelBits::column(place), y = PixelBits::row(place);
        for (int away = warp.lane; away < height; away += warp.size) {
            const int side = halves[away];
            if (side < 0) break;
            const int from = x > side ? x - side : 0, to = side < width - x ? x + side : width - 1;
            for (int sign = -1; sign <= 1; sign += 2) {
                const int row = y + sign * away;
                if (row < 0 || row >= height) continue;
                for (int w = from / 32; w <= to / 32; ++w)
                    blocked[row * PixelBits::words(width) + w] |= PixelBits::part(w, from, to);
            }
        }
        warp.sync();
    }
};

} }  // namespace jaxdet
