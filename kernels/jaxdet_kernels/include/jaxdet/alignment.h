// Depth pixels moved into the colour image, the nearest wins.
// Twin of jaxdet/reference/_align.py.
//
// A key is `depth << 16 | z` (depth in the depth camera, z in the colour camera), so one unsigned
// minimum decides on both, whatever the order of the writes. z stays below 65535, so that no key
// equals NOTHING.
#pragma once
#include "team.h"
#include "projection.h"

namespace jaxdet { namespace {

// A block's tile of an image of a batch, on CUDA. Tiles of an image follow each other row by row.
struct ImageTile {
    int image, top, left;

    ImageTile(const Team& team, int rows, int columns, int height, int width) {
        const int across = (width + columns - 1) / columns;
        const int tiles = across * ((height + rows - 1) / rows), tile = team.index % tiles;
        image = team.index / tiles;
        top = tile / across * rows;
        left = tile % across * columns;
    }
};

struct Alignment {
    enum : unsigned { NOTHING = 0xFFFFFFFFu };
    const unsigned short* depth;       // (rows, columns)
    int rows, columns;
    const float *corner_x, *corner_y;  // (rows + 1, columns + 1)
    Projection projection;
    int fills;                         // 1 where a pixel covers all between its corners, else 0.
    int height, width;                 // Of the colour image.
    unsigned* keys;                    // (height, width)

    // `parameters` are those of the projection, then the lens and `fills`.
    static Alignment of(
        const float* parameters, const unsigned short* depth, int rows, int columns,
        const float* corner_x, const float* corner_y, int height, int width, unsigned* keys
    ) {
        const int fills = static_cast<int>(parameters[Projection::PARAMETERS + 1]);
        const Projection projection = Projection::of(parameters);
        return {depth, rows, columns, corner_x, corner_y, projection, fills, height, width, keys};
    }

    // The colour pixels that a depth pixel covers, inside of the image.
    struct Box {
        int left, top, right, bottom;
        unsigned key;
        bool seen;
    };

    // `bends` where the colour camera's lens does. There is no branch but for that.
    __attribute__((always_inline)) Box box(int v, int u, bool bends) const {
        const int units = depth[(long long)v * columns + u];
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
        return {left, top, right, bottom, (unsigned)units << 16 | (unsigned)first.z, seen};
    }

#if defined(__CUDA_ARCH__)
    // A block of 256 threads lowers the keys by the pixels of one tile of the depth image. It
    // gathers the tile's hits in shared memory, so that each colour pixel is lowered once; where
    // they spread too far, straight in the image.
    enum { TILE_ROWS = 16, TILE_COLUMNS = 32, PIXELS = 2, THREADS = 256, CAPACITY = 8192 };

    void lower_by_tile(const Team& team, const ImageTile& tile) const {
        __shared__ uint4 shared[CAPACITY / 4];
        __shared__ int bounds[4];
        unsigned* hits = (unsigned*)shared;
        const int v = tile.top + team.rank / TILE_COLUMNS;
        const int u = tile.left + team.rank % TILE_COLUMNS;
        const bool bends = projection.model != Projection::PINHOLE;
        Box boxes[PIXELS];
        int left = 1 << 30, top = 1 << 30, right = -1, bottom = -1;
        if (team.rank == 0) {
            bounds[0] = bounds[1] = 1 << 30;
            bounds[2] = bounds[3] = -1;
        }
        #pragma unroll
        for (int k = 0; k < PIXELS; ++k) {
            const int row = v + k * (TILE_ROWS / PIXELS);
            boxes[k].seen = false;
            if (row >= rows || u >= columns || !depth[(long long)row * columns + u]) continue;
            boxes[k] = box(row, u, bends);
            if (!boxes[k].seen) continue;
            left = min(left, boxes[k].left);
            top = min(top, boxes[k].top);
            right = max(right, boxes[k].right);
            bottom = max(bottom, boxes[k].bottom);
        }
        left = __reduce_min_sync(0xffffffffu, left);
        top = __reduce_min_sync(0xffffffffu, top);
        right = __reduce_max_sync(0xffffffffu, right);
        bottom = __reduce_max_sync(0xffffffffu, bottom);
        team.sync();
        if (team.rank % 32 == 0 && right >= 0) {
            atomicMin(&bounds[0], left);
            atomicMin(&bounds[1], top);
            atomicMax(&bounds[2], right);
            atomicMax(&bounds[3], bottom);
        }
        team.sync();
        const int first_u = bounds[0], first_v = bounds[1];
        const int wide = bounds[2] - first_u + 1, tall = bounds[3] - first_v + 1;
        if (bounds[2] < 0) return;  // All threads alike.
        unsigned* corner = keys + (long long)first_v * width + first_u;
        // Rows as long as a power of two, so that places and pixels need no division.
        const int bits = wide <= 32 ? 5 : wide <= 64 ? 6 : wide <= 128 ? 7 : 8, pitch = 1 << bits;
        if (wide > pitch || tall > CAPACITY >> bits) {
            lower(boxes, corner, width, first_u, first_v);
            return;
        }
        const uint4 nothing = make_uint4(NOTHING, NOTHING, NOTHING, NOTHING);
        for (int i = team.rank; i < tall << (bits - 2); i += team.size) shared[i] = nothing;
        team.sync();
        lower(boxes, hits, pitch, first_u, first_v);
        team.sync();
        for (int i = team.rank; i < tall << bits; i += team.size) {
            const unsigned hit = hits[i];
            if (hit != NOTHING)
                atomicMin(corner + (long long)(i >> bits) * width + (i & (pitch - 1)), hit);
        }
    }

    // Lowers the keys of boxes in an image whose first pixel is (first_v, first_u).
    void lower(const Box* boxes, unsigned* image, int pitch, int first_u, int first_v) const {
        #pragma unroll
        for (int k = 0; k < PIXELS; ++k) {
            const Box& at = boxes[k];
            if (!at.seen) continue;
            const int more = at.right - at.left, down = at.bottom - at.top;
            unsigned* place =
                image + (long long)(at.top - first_v) * pitch + (at.left - first_u);
            if (more <= 2 && down <= 2) {
                #pragma unroll
                for (int i = 0; i < 9; ++i)
                    if (i / 3 <= down && i % 3 <= more)
                        atomicMin(place + i / 3 * pitch + i % 3, at.key);
            } else {
                for (int row = 0; row <= down; ++row)
                    for (int column = 0; column <= more; ++column)
                        atomicMin(place + (long long)row * pitch + column, at.key);
            }
        }
    }
#else
    // Some depth pixels of a row. The rows they cover are `top << 16 | bottom`, -1: not seen.
    enum { CHUNK = 512, LINES = 4, FEW = 4, WIDE = 16, SPARE = FEW + WIDE };

    struct Boxes {
        int left[CHUNK], right[CHUNK], span[CHUNK];
        unsigned key[CHUNK];

        void set(int i, const Box& box) {
            left[i] = box.left;
            right[i] = box.right;
            span[i] = box.seen ? box.top << 16 | box.bottom : -1;
            key[i] = box.key;
        }
    };

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
        for (int i = 0; i < count; ++i)
            boxes.set(i, here.box(v, u + i, model != Projection::PINHOLE));
    }

    // Depth pixels that cover the same colour rows lower a line of keys in common, one pixel after
    // the other; the line then lowers all of those rows, in vectors. Where a row's end flickers
    // between two, both of its lines stay in use.
    struct Line {
        unsigned* keys;  // (width + SPARE), NOTHING outside of the columns from `first` to `last`.
        int span, first, last;

        void empty(int width) {
            first = width;
            last = -1;
        }

        // Lowers the columns from `left` to `right`: the first few without a branch.
        void lower(unsigned key, int left, int right) const {
            for (int j = 0; j < FEW; ++j) {
                const unsigned mine = left + j <= right ? key : (unsigned)NOTHING;
                unsigned& place = keys[left + j];
                place = mine < place ? mine : place;
            }
            for (int j = left + FEW; j <= right; ++j) keys[j] = key < keys[j] ? key : keys[j];
        }

        static void lower_wide(const unsigned* __restrict__ line, unsigned* __restrict__ row) {
            for (int k = 0; k < WIDE; ++k) row[k] = line[k] < row[k] ? line[k] : row[k];
        }

        // Lowers the rows, WIDE columns at a time, and the line is empty.
        void lower_rows(unsigned* image, int width) {
            for (int i = span >> 16; i <= (span & 0xFFFF); ++i)
                for (int j = first; j <= last; j += WIDE)
                    lower_wide(keys + j, image + (long long)i * width + j);
            for (int j = first; j <= last; j += WIDE)
                for (int k = 0; k < WIDE; ++k) keys[j + k] = NOTHING;
            empty(width);
        }
    };

    void lower_lines(const Boxes& boxes, int count, Line* lines) const {
        for (int i = 0; i < count;) {
            const int span = boxes.span[i];
            if (span < 0) {
                ++i;
                continue;
            }
            Line& line = lines[(span >> 15 & 2) | (span & 1)];
            if (span != line.span) {
                line.lower_rows(keys, width);
                line.span = span;
            }
            int first = line.first, last = line.last;
            do {
                const int left = boxes.left[i], right = boxes.right[i];
                first = left < first ? left : first;
                last = right > last ? right : last;
                line.lower(boxes.key[i], left, right);
                ++i;
            } while (i < count && boxes.span[i] == span);
            line.first = first;
            line.last = last;
        }
    }

    // The whole frame. `keys` has SPARE more; `scratch` has LINES * (width + SPARE).
    void run(unsigned* scratch, unsigned short* depth_out, unsigned short* z_out) const {
        const long long pixels = (long long)height * width;
        for (long long i = 0; i < pixels + SPARE; ++i) keys[i] = NOTHING;
        for (int i = 0; i < LINES * (width + SPARE); ++i) scratch[i] = NOTHING;
        Line lines[LINES];
        for (int k = 0; k < LINES; ++k) {
            lines[k].keys = scratch + k * (width + SPARE);
            lines[k].span = -1;
            lines[k].empty(width);
        }
        Boxes boxes;
        for (int v = 0; v < rows; ++v) {
            for (int u = 0; u < columns; u += CHUNK) {
                const int count = columns - u < CHUNK ? columns - u : CHUNK;
                project(v, u, count, boxes);
                lower_lines(boxes, count, lines);
            }
        }
        for (int k = 0; k < LINES; ++k) lines[k].lower_rows(keys, width);
        for (long long i = 0; i < pixels; ++i) {
            const unsigned key = keys[i] == NOTHING ? 0 : keys[i];
            depth_out[i] = (unsigned short)(key >> 16);
            z_out[i] = (unsigned short)key;
        }
    }
#endif
};

} }  // namespace jaxdet
