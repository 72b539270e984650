// Detects the strongest corners of a colour image: Canny edges, the local maxima of their corner
// strength, and a selection of these by a minimum distance. Twin of jaxdet/reference/paper/_corners.py.
#pragma once
#include "arena.h"
#include "canny.h"
#include "square_root.h"

namespace jaxdet { namespace {

// Settings, in the order of `corner_settings` in jaxdet/stages/paper/_features.py.
struct CornerSettings {
    int low, high;    // thresholds of Canny, from -1 to 2047
    int limit;        // square of the minimum distance between corners, rounded up; 0: no minimum
    int unused;
    double quality;   // minimum strength of a corner, as a fraction of the largest strength
};

typedef unsigned long long CornerKey;  // strength << 32 | place, see PixelBits::place

// Sums of products of gradients [2^-31] over pixels of a column, and over windows. A pixel is 0 or 255,
// so with k = step(), dx = h k in float32, h = -4 .. 4, and dy = g k - g' k, where g and g' are 0 .. 4.
// Their products are multiples of 2^-31, so integer sums are exact and independent of the order.
struct GradientSums {
    unsigned xx = 0, yy = 0;
    int xy = 0;

    // Adds the products at the middle of 3 x 3 pixels, passed as three bits per row; dx dy is multiplied
    // by `sign`. The function is inlined, so that loops over columns can be vectorized.
    __attribute__((always_inline)) void add(int above, int own, int below, int sign) {
        const int across = right(above) - left(above) + 2 * (right(own) - left(own)) + right(below)
            - left(below);
        const float dx = (float)across * step(), unit = 2147483648.0f;
        const float dy = (float)smooth(below) * step() - (float)smooth(above) * step();
        xx += (unsigned)(int)(dx * dx * unit);
        yy += (unsigned)(int)(dy * dy * unit);
        xy += (int)(dx * dy * unit) * sign;
    }

    static int left(int three) { return three & 1; }
    static int right(int three) { return three >> 2 & 1; }
    static int smooth(int three) { return left(three) + right(three) + (three & 2); }

    // A step from 0 to 255 in OpenCV's scale of gradients, 1 / (4 * 3 * 255).
    static float step() { return (float)(255.0 * (double)(float)(1.0 / (4.0 * 3.0 * 255.0))); }
};

union FloatBits {
    float value;
    int bits;
};

// Local maxima of the corner strength: the smaller eigenvalue of the gradients' covariance in a 3x3
// window (Shi and Tomasi).
//
// A warp processes a word of 32 pixels: on CUDA one pixel per lane, on the CPU several per vector.
struct CornerMaxima {
    typedef unsigned long long Word;

    const unsigned* edges;    // (height, PixelBits::words(width)) edge bitmap
    int height, width;
    double quality;           // minimum strength of a corner, as a fraction of the largest strength
    // Scratch memory.
    int* list;                // (height * PixelBits::words(width)) words that may contain corners
    int* strength;            // size strengths(height, width): strengths as bits of floats, 0 if not a
                              // corner
    CornerKey* keys;          // (height * width) maxima, unordered

    enum { WORD = 32 };  // pixels per word

    // Sums over the columns of a word and one more column on each side.
    struct Columns {
        unsigned xx[WORD + 2], yy[WORD + 2];
        int xy[WORD + 2];
    };
    // Shared memory of the team.
    struct Shared {
        Columns columns[Warp::MOST];
        int listed, strongest, maxima;
    };

    static int strengths(int height, int width) { return height * WORD * PixelBits::words(width) + 1; }

    int words() const { return PixelBits::words(width); }

    // Finds the maxima; returns their number.
    int run(const Team& team, Shared& shared) const {
        const Warp warp(team);
        if (team.rank == 0) shared.listed = shared.strongest = shared.maxima = 0;
        for (int i = team.rank; i < strengths(height, width); i += team.size) strength[i] = 0;
        team.sync();
        for (int i = team.rank; i < height * words(); i += team.size)
            if (Around(*this, i / words(), i % words()).corners())
                list[team.atomic_count(&shared.listed)] = PixelBits::place(i % words(), i / words());
        team.sync();
        int strongest = 0;
        for (int i = warp.index; i < shared.listed; i += warp.count)
            measure(warp, PixelBits::row(list[i]), PixelBits::column(list[i]),
                    shared.columns[warp.index], &strongest);
        team.atomic_max(&shared.strongest, strongest);
        team.sync();
        FloatBits limit;
        limit.bits = shared.strongest;
        limit.value = (float)((double)limit.value * quality);
        for (int i = warp.index; i < shared.listed; i += warp.count)
            search(team, warp, PixelBits::row(list[i]), PixelBits::column(list[i]), limit.bits,
                   &shared.maxima);
        team.sync();
        const int count = shared.maxima;
        team.sync();  // the selection uses the same shared memory
        return count;
    }

    static int greater(int a, int b) { return a > b ? a : b; }

    // Strength as the bits of a float, whose order is that of the floats; 0 if it is not positive.
    static int strength_of(unsigned xx, int xy, unsigned yy) {
        const float unit = 1.0f / 2147483648.0f;
        const float a = 0.5f * ((float)xx * unit), c = 0.5f * ((float)yy * unit), t = a - c;
        const float b = (float)xy * unit;
        const FloatBits found = {(a + c) - SquareRoot::rounded(t * t + b * b)};
        return found.bits > 0 ? found.bits : 0;
    }

    // Neighbourhood of a word of row y: five rows, from two above to two below, with two more columns
    // on each side: bit j is column 32 w - 2 + j. Rows and columns outside the image are mirrored.
    struct Around {
        Word rows[5];

        Around(const CornerMaxima& of, int y, int w) {
            const int words = of.words(), last = of.width - WORD * w + 1;  // bit of the last column
            for (int i = 0; i < 5; ++i) {
                const int row = PixelBits::mirrored(y + i - 2, of.height);
                const unsigned* own = of.edges + row * words + w;
                Word bits = (Word)own[0] << 2;
                if (w > 0) bits |= own[-1] >> 30;
                if (w + 1 < words) bits |= (Word)own[1] << 34;
                if (w == 0) bits |= (bits >> 4 & 1) | (bits >> 2 & 2);
                if (last >= 2 && last <= WORD + 2)
                    bits |= (bits >> (last - 1) & 1) << (last + 1) | (bits >> (last - 2) & 1) << (last + 2);
                rows[i] = bits;
            }
        }

        // Bitmap of the pixels that may be corners: nearby edge bits differ along rows and along columns.
        unsigned corners() const {
            Word across = 0, along = 0;
            for (int i = 0; i < 5; ++i) across |= rows[i] ^ rows[i] >> 2;
            for (int i = 0; i < 3; ++i) along |= rows[i] ^ rows[i + 2];
            along |= along >> 1 | along >> 2 | along >> 3 | along >> 4;
            return (unsigned)((across | across >> 1 | across >> 2) & along);
        }
    };

    // Writes the strengths of a word of row y and updates the maximum.
    void measure(const Warp& warp, int y, int w, Columns& columns, int* strongest) const {
        int* out = strength + ((size_t)y * words() + w) * WORD;
        const Around around(*this, y, w);
        const Word* rows = around.rows;
        const unsigned some = around.corners() & PixelBits::inside(w, width);
        // Outside the image the products of gradients are mirrored, while gradients of mirrored pixels
        // have one component with the opposite sign.
        const int top = y == 0 ? -1 : 1, bottom = y == height - 1 ? -1 : 1;
        const int first = 1 - WORD * w, last = width - WORD * w;
        for (int c = warp.lane; c < WORD + 2; c += warp.size) {
            const int a = (int)(rows[0] >> c), b = (int)(rows[1] >> c), o = (int)(rows[2] >> c);
            const int d = (int)(rows[3] >> c), e = (int)(rows[4] >> c);
            const int inside = ((c >= first) & (c <= last)) ? 1 : -1;
            GradientSums sums;
            sums.add(a, b, o, top * inside);
            sums.add(b, o, d, inside);
            sums.add(o, d, e, bottom * inside);
            columns.xx[c] = sums.xx;
            columns.yy[c] = sums.yy;
            columns.xy[c] = sums.xy;
        }
        warp.sync();
        int most = *strongest;
        for (int l = warp.lane; l < WORD; l += warp.size) {
            const unsigned* xx = columns.xx + l;
            const unsigned* yy = columns.yy + l;
            const int* xy = columns.xy + l;
            const int found = strength_of(xx[0] + xx[1] + xx[2], xy[0] + xy[1] + xy[2],
                                          yy[0] + yy[1] + yy[2]);
            out[l] = some >> l & 1 ? found : 0;
            most = greater(most, out[l]);
        }
        warp.sync();
        *strongest = most;
    }

    // Lists the pixels of a word that exceed the limit and are maxima of their 3x3 window, except on
    // the image border.
    void search(const Team& team, const Warp& warp, int y, int w, int limit,
                int* count) const {
        if (y == 0 || y == height - 1) return;
        const int pitch = WORD * words();
        const int* at = strength + (size_t)y * pitch + WORD * w;
        unsigned found = warp.bits([&](int l) {
            const int *own = at + l, *above = own - pitch, *below = own + pitch;
            const int sides = greater(own[-1], own[1]);
            const int upper = greater(above[0], greater(above[-1], above[1]));
            const int lower = greater(below[0], greater(below[-1], below[1]));
            return (own[0] > limit) & (own[0] >= greater(sides, greater(upper, lower)));
        });
        found &= PixelBits::inside(w, width - 1);
        if (w == 0) found &= ~1u;
        for (unsigned left = found; left; left &= left - 1) {
            const int l = BitRows::lowest(left);
            if (l % warp.size == warp.lane)
                keys[team.atomic_count(count)] =
                    (CornerKey)(unsigned)at[l] << 32 | (unsigned)PixelBits::place(WORD * w + l, y);
        }
    }
};

// Sorts distinct 64-bit keys in descending order: a bitonic network on CUDA, a radix sort on the CPU.
struct KeySort {
    // `other` is scratch memory of the same length as `keys`. Ends in a sync.
#if defined(__CUDA_ARCH__)
    static void run(const Team& team, CornerKey* keys, CornerKey*, int count) {
        for (int run = 2; run < 2 * count; run *= 2)
            // The first exchange of a run pairs mirrored positions, so that all exchanges have the same
            // direction and positions beyond the last key need not exist.
            for (int mask = run - 1, away = run / 2; away; away /= 2, mask = away) {
                for (int i = team.rank; i < count; i += team.size) {
                    const int partner = i ^ mask;
                    if (partner <= i || partner >= count || keys[i] > keys[partner]) continue;
                    const CornerKey swap = keys[i];
                    keys[i] = keys[partner];
                    keys[partner] = swap;
                }
                team.sync();
            }
    }
#else
    static void run(const Team&, CornerKey* keys, CornerKey* other, int count) {
        enum { BITS = 8, BINS = 1 << BITS };
        CornerKey differ = 0, *from = keys, *to = other;
        for (int i = 1; i < count; ++i) differ |= keys[i] ^ keys[0];
        for (int shift = 0; shift < 64 && differ >> shift; shift += BITS) {
            if (!(differ >> shift & (BINS - 1))) continue;
            int bins[BINS + 1] = {};
            // Bin BINS - 1 - digit, for descending order.
            for (int i = 0; i < count; ++i) ++bins[BINS - (from[i] >> shift & (BINS - 1))];
            for (int i = 1; i < BINS; ++i) bins[i] += bins[i - 1];
            for (int i = 0; i < count; ++i)
                to[bins[BINS - 1 - (from[i] >> shift & (BINS - 1))]++] = from[i];
            CornerKey* const swap = from;
            from = to;
            to = swap;
        }
        if (from != keys)
            for (int i = 0; i < count; ++i) keys[i] = from[i];
    }
#endif
};

// Greedy non-maximum suppression of corners by a minimum distance: in order of decreasing strength (equal
// corners in reverse raster order), a corner is accepted unless an accepted corner is closer than the
// distance.
struct CornerSelection {
    int height, width;
    int limit;            // square of the minimum distance, rounded up; 0: no minimum
    int slots;
    int *u_out, *v_out;   // (slots) columns and rows, 0 in unused slots
    // Scratch memory.
    unsigned* blocked;    // (height, PixelBits::words(width)) pixels close to an accepted corner
    // (height) half-width of the disk by vertical distance from its centre; -1: outside
    int* halves;
    CornerKey* other;     // (count) memory that `KeySort` needs

    // Selects corners; returns their number, at most slots + 1. One warp selects.
    int run(const Team& team, CornerKey* keys, int count) const {
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

    // A warp tests one corner per lane, accepts the first that is not blocked, and tests the corners
    // after it again. Returns the number of accepted corners.
    int take(const Warp& warp, const CornerKey* keys, int count) const {
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

struct Corners {
    int height, width;
    CornerSettings settings;
    int slots;

    enum { BLOCKED = 480 * 640 / 32 };  // words of a bitmap that fits in `Shared`

    // Fast memory of a team: shared memory on CUDA. Each stage reuses it.
    union Shared {
        Canny::Tile tile;
        CornerMaxima::Shared maxima;
        unsigned blocked[BLOCKED];
    };

    // Scratch memory of a team.
    struct Scratch {
        unsigned *weak, *edges, *blocked;
        int *list, *halves, *strength;
        CornerKey *keys, *other;

        Scratch(Arena& arena, int height, int width) {
            arena.take(height * PixelBits::words(width), weak, edges, blocked, list);
            arena.take(height, halves);
            arena.take(CornerMaxima::strengths(height, width), strength);
            arena.take(2 * height * width, keys, other);
        }
    };

    static int scratch_words(int height, int width) {
        Arena arena = Arena::counting();
        Scratch(arena, height, width);
        return arena.used;
    }

    // Writes the columns and rows of corners and their number, at most slots + 1.
    void run(const Team& team, Shared& shared, const unsigned char* color, int* own, int* u_out,
             int* v_out, int* count_out) const {
        Arena arena{own};
        const Scratch scratch(arena, height, width);
        Canny{color, height, width, settings.low, settings.high, scratch.weak, scratch.edges}
            .run(team, shared.tile);
        Hysteresis{height, PixelBits::words(width) / 2, (const Hysteresis::Word*)scratch.weak,
                   (Hysteresis::Word*)scratch.edges}.run(team);
        const int maxima = CornerMaxima{scratch.edges, height, width, settings.quality,
                                        scratch.list, scratch.strength, scratch.keys}
            .run(team, shared.maxima);
        const bool fits = height * PixelBits::words(width) <= BLOCKED;
        const int count = CornerSelection{height, width, settings.limit, slots, u_out, v_out,
                                          fits ? shared.blocked : scratch.blocked, scratch.halves,
                                          scratch.other}.run(team, scratch.keys, maxima);
        if (team.rank == 0) *count_out = count;
    }
};

} }  // namespace jaxdet
