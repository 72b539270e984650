// Greedy non-maximum suppression of corners by a minimum distance. Twin of `_without_near` in
// jaxdet/reference/paper/_corners.py: in order of decreasing strength (equal corners in reverse raster
// order), a corner is accepted unless an accepted corner is closer than the distance.
#pragma once
#include "key_sort.h"
#include "pixel_bits.h"
#include "square_root.h"
#include "warp.h"

namespace jaxdet { namespace {

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
