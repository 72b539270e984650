// Depth at some pixels of the colour image: depth pixels are moved there, and the nearest wins.
// Twin of jaxdet/reference/_align.py.
//
// A key is `depth << 16 | z` (depth in the depth camera, z in the colour camera), so one unsigned
// minimum decides on both, whatever the order of the writes. z stays below 65535, so that no key
// equals NOTHING.
#pragma once
#include "arena.h"
#include "pixel_bits.h"
#include "projection.h"

namespace jaxdet { namespace {

struct Alignment {
    enum : unsigned { NOTHING = 0xFFFFFFFFu };
    enum {
        NEAR_WORDS = 480 * 640 / 32,  // words of an image of bits in the nearest memory
        REACH = 4  // a box that covers no more columns and rows is looked up by its first pixel
    };
    const unsigned short* depth;       // (rows, columns)
    int rows, columns;
    const float *corner_x, *corner_y;  // (rows + 1, columns + 1)
    Projection projection;
    int fills;                         // 1 where a pixel covers all between its corners, else 0.
    int height, width;                 // Of the colour image.
    // Scratch memory: a bit for pixels up to REACH before a wanted one, in both directions; and the
    // keys, which are valid for wanted pixels alone.
    unsigned *wanted, *keys;           // (height, PixelBits::words(width)), (height, width)

    static int scratch_words(int height, int width) {
        return height * (PixelBits::words(width) + width);
    }

    // `parameters` are those of the projection, then the lens, `fills`, height and width. `near` has
    // NEAR_WORDS.
    static Alignment of(
        const float* parameters, const unsigned short* depth, int rows, int columns,
        const float* corner_x, const float* corner_y, unsigned* near, int* own
    ) {
        const float* const more = parameters + Projection::PARAMETERS + 1;
        const int fills = (int)more[0], height = (int)more[1], width = (int)more[2];
        const int words = height * PixelBits::words(width);
        unsigned *const wanted = (unsigned*)own, *const keys = wanted + words;
        return {depth, rows, columns, corner_x, corner_y, Projection::of(parameters), fills, height,
                width, words <= NEAR_WORDS ? near : wanted, keys};
    }

    // Writes the keys of `points` pixels (u, v), 0 where nothing hits.
    void run(const Team& team, int points, const int* u, const int* v, unsigned* keys_out) const {
        const int words = PixelBits::words(width);
        for (int i = team.rank; i < height * words; i += team.size) wanted[i] = 0;
        team.sync();
        for (int i = team.rank; i < points; i += team.size) {
            const int left = u[i] > REACH ? u[i] - REACH : 0, top = v[i] > REACH ? v[i] - REACH : 0;
            for (int y = top; y <= v[i]; ++y)
                for (int w = left / 32; w <= u[i] / 32; ++w)
                    team.atomic_or((int*)wanted + y * words + w, (int)PixelBits::part(w, left, u[i]));
            keys[(size_t)v[i] * width + u[i]] = NOTHING;
        }
        team.sync();
        lower_all(team);
        team.sync();
        for (int i = team.rank; i < points; i += team.size) {
            const unsigned key = keys[(size_t)v[i] * width + u[i]];
            keys_out[i] = key == NOTHING ? 0 : key;
        }
    }

    // The colour pixels that a depth pixel covers, inside of the image; the key is NOTHING where there
    // are none.
    struct Box {
        int left, top, right, bottom;
        unsigned key;
    };

    // `bends` where the colour camera's lens does. There is no branch but for that.
    __attribute__((always_inline)) Box box(int v, int u, int units, bool bends) const {
        const long long one = (long long)v * (columns + 1) + u;
        const long long two = one + fills * (columns + 2);
        Projection::Point first, last;
        projection.through(units, corner_x[one], corner_y[one], bends, &first);
        projection.through(units, corner_x[two], corner_y[two], bends, &last);
        const int left = first.u > 0 ? first.u : 0, top = first.v > 0 ? first.v : 0;
        const int right = last.u < width - 1 ? last.u : width - 1;
        const int bottom = last.v < height - 1 ? last.v : height - 1;
        const bool seen =
            (units > 0) & first.seen & last.seen & (left <= right) & (top <= bottom);
        const unsigned key = (unsigned)units << 16 | (unsigned)first.z;
        return {left, top, right, bottom, seen ? key : (unsigned)NOTHING};
    }

    // Lowers the keys of a box, if it may cover a wanted pixel.
    __attribute__((always_inline)) void lower(const Team& team, const Box& box) const {
        if (box.key == NOTHING) return;
        const bool large = (box.right - box.left > REACH) | (box.bottom - box.top > REACH);
        const unsigned bits = wanted[box.top * PixelBits::words(width) + box.left / 32];
        if (!(large | (bits >> (box.left & 31) & 1))) return;
        for (int y = box.top; y <= box.bottom; ++y)
            for (int x = box.left; x <= box.right; ++x)
                team.atomic_min(keys + (size_t)y * width + x, box.key);
    }

#if defined(__CUDA_ARCH__)
    void lower_all(const Team& team) const {
        const bool bends = projection.model != Projection::PINHOLE;
        for (int i = team.rank; i < rows * columns; i += team.size) {
            const int units = __ldg(depth + i);
            if (units) lower(team, box(i / columns, i % columns, units, bends));
        }
    }
#else
    // Boxes of some depth pixels of a row.
    enum { CHUNK = 512 };

    struct Boxes {
        int left[CHUNK], top[CHUNK], right[CHUNK], bottom[CHUNK];
        unsigned key[CHUNK];

        void set(int i, const Box& box) {
            left[i] = box.left;
            top[i] = box.top;
            right[i] = box.right;
            bottom[i] = box.bottom;
            key[i] = box.key;
        }
        Box at(int i) const { return {left[i], top[i], right[i], bottom[i], key[i]}; }
    };

    void lower_all(const Team& team) const {
        Boxes boxes;
        for (int v = 0; v < rows; ++v)
            for (int u = 0; u < columns; u += CHUNK) {
                const int count = columns - u < CHUNK ? columns - u : (int)CHUNK;
                project(v, u, count, boxes);
                for (int i = 0; i < count; ++i) lower(team, boxes.at(i));
            }
    }

    // A loop for each lens model, which the compiler turns into vector instructions.
    void project(int v, int u, int count, Boxes& __restrict__ boxes) const {
        typedef Projection Lens;
        const int model = projection.model;
        if (model == Lens::PINHOLE) project_by(Lens::PINHOLE, v, u, count, boxes);
        else if (model == Lens::PLUMB_BOB) project_by(Lens::PLUMB_BOB, v, u, count, boxes);
        else if (model == Lens::RATIONAL) project_by(Lens::RATIONAL, v, u, count, boxes);
        else project_by(Lens::EQUIDISTANT, v, u, count, boxes);
    }

    __attribute__((always_inline)) void project_by(
        int model, int v, int u, int count, Boxes& __restrict__ boxes) const {
        Alignment here = *this;
        float parameters[Projection::PARAMETERS];
        for (int i = 0; i < Projection::PARAMETERS; ++i) parameters[i] = projection.p[i];
        here.projection = {parameters, model};
        const unsigned short* const line = depth + (size_t)v * columns;
        for (int i = 0; i < count; ++i)
            boxes.set(i, here.box(v, u + i, line[u + i], model != Projection::PINHOLE));
    }
#endif
};

} }  // namespace jaxdet
