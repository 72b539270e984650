// Local maxima of the corner strength of an edge image. Twin of `strongest_corners` in
// jaxdet/reference/paper/_corners.py, without the minimum distance, for which see corner_selection.h.
#pragma once
#include "corner_strength.h"
#include "pixel_bits.h"
#include "warp.h"

namespace jaxdet { namespace {

// A warp processes a word of 32 pixels: on CUDA one pixel per lane, on the CPU several per vector.
struct CornerMaxima {
    typedef unsigned long long Word;
    typedef unsigned long long Key;  // strength << 32 | place

    const unsigned* edges;    // (height, outer_words(width)) edge bitmap, from `mirror`
    int height, width;
    double quality;           // minimum strength of a corner, as a fraction of the largest strength
    // Scratch memory.
    int* list;                // (height * PixelBits::words(width)) words that may contain corners
    int* strength;            // (strengths(height, width)) bits of floats, 0 if not a corner
    Key* keys;                // (height * width) maxima, unordered

    enum { MARGIN = 2, WORD = 32 };  // padding words on each side of a row of edges; pixels per word

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

    static int outer_words(int width) { return PixelBits::words(width) + 2 * MARGIN; }
    static int strengths(int height, int width) { return height * WORD * PixelBits::words(width) + 1; }

    int words() const { return PixelBits::words(width); }

    // Copies the edge bitmap; two columns on each side of the image mirror those inside.
    static void mirror(const Team& team, const unsigned* from, unsigned* to, int height, int width) {
        const int inner = PixelBits::words(width), outer = outer_words(width);
        const int first = MARGIN * WORD, last = first + width - 1;
        for (int y = team.rank; y < height; y += team.size) {
            unsigned* row = to + (size_t)y * outer;
            for (int w = -MARGIN; w < inner + MARGIN; ++w)
                row[MARGIN + w] = w >= 0 && w < inner ? from[(size_t)y * inner + w] : 0;
            for (int k = 1; k <= 2; ++k) {
                PixelBits::copy(row, first + k, first - k);
                PixelBits::copy(row, last - k, last + k);
            }
        }
        team.sync();
    }

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
        const CornerStrength::Float limit = {share_of(shared.strongest)};
        for (int i = warp.index; i < shared.listed; i += warp.count)
            search(team, warp, PixelBits::row(list[i]), PixelBits::column(list[i]), limit.bits,
                   &shared.maxima);
        team.sync();
        return shared.maxima;
    }

    static int greater(int a, int b) { return a > b ? a : b; }

    float share_of(int bits) const {
        CornerStrength::Float strongest;
        strongest.bits = bits;
        return (float)((double)strongest.value * quality);
    }

    // Neighbourhood of a word of row y: five rows, from two above to two below, with two more columns
    // on each side: bit j is column 32 w - 2 + j. Rows outside the image are mirrored.
    struct Around {
        Word rows[5];

        Around(const CornerMaxima& of, int y, int w) {
            for (int i = 0; i < 5; ++i) {
                const int row = PixelBits::mirrored(y + i - 2, of.height);
                const unsigned* own = of.edges + (size_t)row * outer_words(of.width) + MARGIN + w;
                rows[i] = own[-1] >> 30 | (Word)own[0] << 2 | (Word)own[1] << 34;
            }
        }

        // Bitmap of pixels that may be corners: edges nearby differ in both directions.
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
            const int found = CornerStrength::of(xx[0] + xx[1] + xx[2], xy[0] + xy[1] + xy[2],
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
                    (Key)(unsigned)at[l] << 32 | (unsigned)PixelBits::place(WORD * w + l, y);
        }
    }
};

} }  // namespace jaxdet
