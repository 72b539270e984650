// Depth at `wanted` pixels of the colour image: that of the nearest depth pixel that is projected there.
// Twin of jaxdet/reference/paper/_align.py.
//
// A key is `depth << 16 | z` with the depth in the depth camera and z in the colour camera. So a single
// unsigned minimum selects both, and the order of the writes does not matter. z is below 65535, so that
// no key equals NOTHING. A tile of depth pixels is projected only if the bounds of its projection, which
// follow from its smallest and largest depth, contain a wanted pixel.
#pragma once
#include "bits.h"
#include "pixel_bits.h"
#include "projection.h"
#include "warp.h"

namespace jaxdet { namespace {

struct Alignment {
    typedef Projection::Bounds Bounds;
    enum : unsigned { NOTHING = 0xFFFFFFFFu };
    enum {
        NEAR_WORDS = 480 * 640 / 32,  // words of a bitmap in shared memory or on the stack
        TILE = 8,                     // rows and columns of a tile of depth pixels
        PIXELS = TILE * TILE
    };
    // Shared memory of a team on CUDA, memory on the stack on the CPU.
    struct Near {
        unsigned words[NEAR_WORDS];
    };

    const unsigned short* depth;       // (rows, columns) depth image
    int rows, columns;                 // at least TILE
    const float *corner_x, *corner_y;  // (rows + 1, columns + 1) rays of the pixels' corners
    const float* tile_rays;            // (tiles, 4) smallest and largest x, smallest and largest y of rays
    Projection projection;
    int fills;                         // 1 if a depth pixel covers all colour pixels between its corners, else 0
    int height, width;                 // size of the colour image
    // Scratch memory: bitmap of the wanted pixels, and keys, which are valid only at wanted pixels.
    unsigned *wanted, *keys;           // (height, PixelBits::words(width)), (height, width)

    static int scratch_words(int height, int width) {
        return height * (PixelBits::words(width) + width);
    }

    // `parameters` holds the parameters of the projection, the lens model, `fills`, and the height and
    // width of the colour image. `near` has NEAR_WORDS words.
    static Alignment of(
        const float* parameters, const unsigned short* depth, int rows, int columns,
        const float* rays, const float* tile_rays, unsigned* near, int* own
    ) {
        const float* const more = parameters + Projection::PARAMETERS + 1;
        const int fills = (int)more[0], height = (int)more[1], width = (int)more[2];
        const int words = height * PixelBits::words(width);
        unsigned *const wanted = (unsigned*)own, *const keys = wanted + words;
        const float* const corner_y = rays + (size_t)(rows + 1) * (columns + 1);
        return {depth, rows, columns, rays, corner_y, tile_rays, Projection::of(parameters), fills,
                height, width, words <= NEAR_WORDS ? near : wanted, keys};
    }

    // Writes the keys of `points` pixels (u, v), 0 if no depth pixel covers the pixel.
    void run(const Team& team, int points, const int* u, const int* v, unsigned* keys_out) const {
        const int words = PixelBits::words(width);
        for (int i = team.rank; i < height * words; i += team.size) wanted[i] = 0;
        team.sync();
        for (int i = team.rank; i < points; i += team.size) {
            team.atomic_or((int*)wanted + v[i] * words + u[i] / 32, 1 << (u[i] & 31));
            keys[(size_t)v[i] * width + u[i]] = NOTHING;
        }
        team.sync();
        const Warp warp(team);
        const int tiles = (rows + TILE - 1) / TILE * tiles_across();
        for (int first = warp.index * warp.size; first < tiles; first += warp.count * warp.size) {
            const int own = first + warp.lane;
            unsigned some = warp.ballot(own < tiles && may_cover(own));
            for (; some; some &= some - 1) lower(team, warp, first + BitRows::lowest(some));
        }
        team.sync();
        for (int i = team.rank; i < points; i += team.size) {
            const unsigned key = keys[(size_t)v[i] * width + u[i]];
            keys_out[i] = key == NOTHING ? 0 : key;
        }
    }

    // Tiles at the right and bottom edge overlap their neighbours so that all tiles are complete.
    int tiles_across() const { return (columns + TILE - 1) / TILE; }
    int tile_row(int tile) const { return begin(tile / tiles_across(), rows); }
    int tile_column(int tile) const { return begin(tile % tiles_across(), columns); }
    static int begin(int tile, int size) { return tile * TILE < size - TILE ? tile * TILE : size - TILE; }

    // Whether the depth pixels of a tile may cover a wanted pixel.
    bool may_cover(int tile) const {
        const Interval units = depths(tile);
        if (units.high == 0) return false;
        const float* const rays = tile_rays + 4 * (size_t)tile;
        const Interval x(rays[0], rays[1]), y(rays[2], rays[3]);
        return any_wanted(clipped(projection.bounds(units, x, y)));
    }

    // Smallest and largest measured depth of a tile; the largest is 0 if nothing is measured.
    Interval depths(int tile) const {
        const unsigned short* line = depth + (size_t)tile_row(tile) * columns + tile_column(tile);
        // Per column of the tile: smallest depth minus one, so that 0 becomes the largest; largest depth.
        unsigned short less[TILE], most[TILE];
        for (int c = 0; c < TILE; ++c) {
            less[c] = 0xffff;
            most[c] = 0;
        }
        for (int r = 0; r < TILE; ++r, line += columns)
            for (int c = 0; c < TILE; ++c) {
                const unsigned short units = line[c], below = units - 1;
                less[c] = below < less[c] ? below : less[c];
                most[c] = units > most[c] ? units : most[c];
            }
        int low = 0xffff, high = 0;
        for (int c = 0; c < TILE; ++c) {
            low = less[c] < low ? less[c] : low;
            high = most[c] > high ? most[c] : high;
        }
        return {(float)(low + 1), (float)high};
    }

    Bounds clipped(Bounds box) const {
        return {box.left > 0 ? box.left : 0, box.top > 0 ? box.top : 0,
                box.right < width - 1 ? box.right : width - 1,
                box.bottom < height - 1 ? box.bottom : height - 1};
    }

    // Whether a box may contain a wanted pixel; always true for large boxes.
    bool any_wanted(Bounds box) const {
        if (box.left > box.right || box.top > box.bottom) return false;
        const int left = box.left / 32, right = box.right / 32;
        if (right - left > 1 || box.bottom - box.top > 64) return true;
        const unsigned first = PixelBits::part(left, box.left, box.right);
        const unsigned last = PixelBits::part(right, box.left, box.right);
        unsigned some = 0;
        for (int y = box.top; y <= box.bottom; ++y) {
            const unsigned* const row = wanted + y * PixelBits::words(width);
            some |= (row[left] & first) | (row[right] & last);
        }
        return some;
    }

    // Boxes of colour pixels covered by one lane's depth pixels of a tile, and their keys.
    struct Boxes {
        enum { COUNT = PIXELS / Warp::size };
        int left[COUNT], top[COUNT], right[COUNT], bottom[COUNT];
        unsigned key[COUNT];
    };

    // Updates the smallest keys of the wanted pixels that a tile covers.
    void lower(const Team& team, const Warp& warp, int tile) const {
        Boxes boxes;
        cover(warp, tile, boxes);
        Extremes columns, rows;
        for (int k = 0; k < Boxes::COUNT; ++k) {
            columns.add(boxes.left[k], boxes.right[k]);
            rows.add(boxes.top[k], boxes.bottom[k]);
        }
        columns.join(warp);
        rows.join(warp);
        if (rows.low > rows.high) return;
        const int left = columns.low / 32, across = columns.high / 32 - left + 1;
        const int words = across * (rows.high - rows.low + 1);
        for (int start = 0; start < words; start += warp.size) {
            const int i = start + warp.lane;
            const unsigned mine = i < words ? wanted_of(columns, rows.low + i / across, left + i % across) : 0;
            for (unsigned some = warp.ballot(mine); some; some &= some - 1) {
                const int lane = BitRows::lowest(some), word = start + lane;
                const int x = 32 * (left + word % across), y = rows.low + word / across;
                for (unsigned bits = warp.broadcast(mine, lane); bits; bits &= bits - 1)
                    lower(team, warp, boxes, x + BitRows::lowest(bits), y);
            }
        }
    }

    unsigned wanted_of(const Extremes& columns, int y, int w) const {
        return wanted[y * PixelBits::words(width) + w] & PixelBits::part(w, columns.low, columns.high);
    }

    void lower(const Team& team, const Warp& warp, const Boxes& boxes, int x, int y) const {
        unsigned least = NOTHING;
        for (int k = 0; k < Boxes::COUNT; ++k) {
            const bool covers = (boxes.left[k] <= x) & (x <= boxes.right[k]) & (boxes.top[k] <= y) &
                                (y <= boxes.bottom[k]);
            const bool nearer = covers & (boxes.key[k] < least);
            least = nearer ? boxes.key[k] : least;
        }
        least = warp.min(least);
        if (warp.lane == 0 && least != NOTHING)
            team.atomic_min(keys + (size_t)y * width + x, least);
    }

    // Sets box `k` from a depth pixel and the rays of its first and last corner; the box is empty if no
    // colour pixel is covered. The only branch is on `bends`, which is true for a lens with distortion.
    __attribute__((always_inline)) void cover(
        Boxes& boxes, int k, int units, float x0, float y0, float x1, float y1, bool bends) const {
        Projection::Point first, last;
        projection.through(units, x0, y0, bends, &first);
        projection.through(units, x1, y1, bends, &last);
        const Bounds pixels = clipped({first.u, first.v, last.u, last.v});
        const bool seen = (units > 0) & first.seen & last.seen & (pixels.left <= pixels.right) &
                          (pixels.top <= pixels.bottom);
        boxes.left[k] = seen ? pixels.left : (int)Extremes::MOST;
        boxes.top[k] = seen ? pixels.top : (int)Extremes::MOST;
        boxes.right[k] = seen ? pixels.right : -1;
        boxes.bottom[k] = seen ? pixels.bottom : -1;
        boxes.key[k] = (unsigned)units << 16 | (unsigned)first.z;
    }

#if defined(__CUDA_ARCH__)
    void cover(const Warp& warp, int tile, Boxes& boxes) const {
        for (int k = 0; k < Boxes::COUNT; ++k) {
            const int i = k * warp.size + warp.lane;
            const int row = tile_row(tile) + i / TILE, column = tile_column(tile) + i % TILE;
            const int one = row * (columns + 1) + column, two = one + fills * (columns + 2);
            cover(boxes, k, depth[row * columns + column], corner_x[one], corner_y[one],
                  corner_x[two], corner_y[two], projection.model != Projection::PINHOLE);
        }
    }
#else
    // Depth pixels of a tile and the rays of their corners.
    struct Tile {
        unsigned short units[PIXELS];
        float x0[PIXELS], y0[PIXELS], x1[PIXELS], y1[PIXELS];
    };

    void cover(const Warp&, int number, Boxes& boxes) const {
        Tile tile;
        for (int r = 0; r < TILE; ++r) {
            const int row = tile_row(number) + r, column = tile_column(number), i = r * TILE;
            const size_t one = (size_t)row * (columns + 1) + column, two = one + fills * (columns + 2);
            __builtin_memcpy(tile.units + i, depth + (size_t)row * columns + column, 2 * TILE);
            __builtin_memcpy(tile.x0 + i, corner_x + one, 4 * TILE);
            __builtin_memcpy(tile.y0 + i, corner_y + one, 4 * TILE);
            __builtin_memcpy(tile.x1 + i, corner_x + two, 4 * TILE);
            __builtin_memcpy(tile.y1 + i, corner_y + two, 4 * TILE);
        }
        typedef Projection Lens;
        const int model = projection.model;
        if (model == Lens::PINHOLE) cover_by(Lens::PINHOLE, tile, boxes);
        else if (model == Lens::PLUMB_BOB) cover_by(Lens::PLUMB_BOB, tile, boxes);
        else if (model == Lens::RATIONAL) cover_by(Lens::RATIONAL, tile, boxes);
        else cover_by(Lens::EQUIDISTANT, tile, boxes);
    }

    // One loop per lens model, so that the compiler can vectorize it.
    __attribute__((always_inline)) void cover_by(
        int model, const Tile& tile, Boxes& __restrict__ boxes) const {
        Alignment here = *this;
        float parameters[Projection::PARAMETERS];
        for (int i = 0; i < Projection::PARAMETERS; ++i) parameters[i] = projection.p[i];
        here.projection = {parameters, model};
        for (int i = 0; i < PIXELS; ++i)
            here.cover(boxes, i, tile.units[i], tile.x0[i], tile.y0[i], tile.x1[i], tile.y1[i],
                       model != Projection::PINHOLE);
    }
#endif
};

} }  // namespace jaxdet
