// Cells of the depth image: one depth each, the place in space, and the box in the colour image.
// Twin of jaxdet/reference/_cells.py.
#pragma once
#include "team.h"
#include "cell_depth.h"
#include "warp.h"
#include "pixel_pair.h"
#include "projection.h"

namespace jaxdet {
namespace {

struct CellGrid {
    enum { RAY_BITS = 20, MOST_COLUMNS = 4096 };
    const unsigned short* depth;    // (height, width)
    int width, rows, columns, side;
    const int* near;                // By depth, see `CellDepth`.
    const int* rays;                // (3, rows, columns), RAY_BITS fraction bits.
    const int* offset;              // (3)
    const float *corner_x, *corner_y;  // (rows + 1, columns + 1)
    Projection projection;
    const int* last;                // The colour image's last column and row.
    bool aligned;
    int *x_out, *y_out, *z_out;
    int *uv_min_out, *uv_max_out;   // Each a `PixelPair`.
    bool* in_view_out;

    CellDepth cell(int row, int column) const {
        return {depth + (long long)row * side * width + column * side, width, side, near};
    }

    // `ray d` rounded, in 32 bits: ten fraction bits at a time. Rays are below 2^23.
    static int along(int ray, int d) {
        return ((ray >> 10) * d + (((ray & 1023) * d) >> 10) + 512) >> 10;
    }

    // A cell's ray.
    struct Ray {
        int x, y, z;
    };

    Ray ray(int k) const {
        const int all = rows * columns;
        return {rays[k], rays[all + k], rays[2 * all + k]};
    }

    void place(int k, const Ray& ray, int d) const {
        const int z = along(ray.z, d) + offset[2];
        const int seen = -(int)(d > 0 && z > 0);
        const int x = (along(ray.x, d) + offset[0]) & seen;
        const int y = (along(ray.y, d) + offset[1]) & seen;
        x_out[k] = x;
        y_out[k] = y;
        z_out[k] = (z < 65535 ? z : 65535) & seen;
    }

    static int clamp(int value, int high) { return value < 0 ? 0 : value > high ? high : value; }

    // What a cell covers: between the projections of its upper left and its lower right corner.
    void box(int k, const Projection::Point& one, const Projection::Point& two) const {
        const int low_u = one.u < two.u ? one.u : two.u, high_u = one.u < two.u ? two.u : one.u;
        const int low_v = one.v < two.v ? one.v : two.v, high_v = one.v < two.v ? two.v : one.v;
        const bool inside = (z_out[k] > 0) & one.seen & two.seen & (high_u >= 0) &
                            (high_v >= 0) & (low_u <= last[0]) & (low_v <= last[1]);
        const int shown = -(int)inside;
        uv_min_out[k] = PixelPair(clamp(low_u, last[0]), clamp(low_v, last[1])).word & shown;
        uv_max_out[k] = PixelPair(clamp(high_u, last[0]), clamp(high_v, last[1])).word & shown;
        in_view_out[k] = inside;
    }

    // The rays of the corners of a cell in the depth camera.
    struct Corners {
        float x[2], y[2];
    };

    Corners corners(int row, int column) const {
        if (aligned) return {{0.0f, 0.0f}, {0.0f, 0.0f}};
        const int one = row * (columns + 1) + column, two = one + columns + 2;
        return {{corner_x[one], corner_x[two]}, {corner_y[one], corner_y[two]}};
    }

    // The box of a cell whose depth is d; `bends` where the lens does.
    void box(int row, int column, const Corners& at, int d, bool bends) const {
        const int k = row * columns + column, u = column * side, v = row * side;
        Projection::Point one{u, v, d, true}, two{u + side - 1, v + side - 1, d, true};
        if (!aligned) {
            projection.through(d, at.x[0], at.y[0], bends, &one);
            projection.through(d, at.x[1], at.y[1], bends, &two);
        }
        box(k, one, two);
    }

#if !defined(__CUDA_ARCH__)
    // Of a row of cells.
    void depths(int row, CellRow& beside, int* d) const {
        enum { LANES = CellRow::LANES };
        if (side > CellRow::MOST_SIDE || columns < LANES) {
            for (int column = 0; column < columns; ++column) d[column] = cell(row, column).depth();
            return;
        }
        for (int start = 0; start < columns; start += LANES) {
            // The last ones are found again where they don't fill the lanes.
            const int from = start < columns - LANES ? start : columns - LANES;
            const unsigned short* first = cell(row, from).first;
            // Those of the next row of cells are on their way meanwhile.
            for (int v = side; row + 1 < rows && v < 2 * side; ++v)
                for (int u = 0; u < LANES * side; u += 32) __builtin_prefetch(first + v * width + u);
            switch (side) {
                case 1: beside.run(first, width, 1, d + from); break;
                case 2: beside.run(first, width, 2, d + from); break;
                case 3: beside.run(first, width, 3, d + from); break;
                case 4: beside.run(first, width, 4, d + from); break;
                case 5: beside.run(first, width, 5, d + from); break;
                default: beside.run(first, width, side, d + from);
            }
        }
    }

    // Of a row of cells.
    void boxes(int row, const int* d) const {
        const bool bends = projection.model != Projection::PINHOLE;
        if (aligned || bends) {
            for (int column = 0; column < columns; ++column)
                box(row, column, corners(row, column), d[column], bends);
            return;
        }
        // Of a copy that nothing else is written to, so that the loops have no loads but the rays'.
        float own[Projection::PARAMETERS];
        for (int i = 0; i < Projection::PARAMETERS; ++i) own[i] = projection.p[i];
        const Projection pinhole{own, Projection::PINHOLE};
        int u[2][MOST_COLUMNS], v[2][MOST_COLUMNS], seen[2][MOST_COLUMNS];
        for (int which = 0; which < 2; ++which) {
            const int at = (row + which) * (columns + 1) + which;
            const float *x = corner_x + at, *y = corner_y + at;
            for (int column = 0; column < columns; ++column) {
                Projection::Point there;
                pinhole.through(d[column], x[column], y[column], false, &there);
                u[which][column] = there.u;
                v[which][column] = there.v;
                seen[which][column] = there.seen;
            }
        }
        for (int column = 0; column < columns; ++column)
            box(row * columns + column, {u[0][column], v[0][column], 0, seen[0][column] != 0},
                {u[1][column], v[1][column], 0, seen[1][column] != 0});
    }
#endif

    void run(const Team& team) const {
#if defined(__CUDA_ARCH__)
        const bool bends = projection.model != Projection::PINHOLE;
        const Warp warp(team);
        for (int row = warp.index; row < rows; row += warp.count)
            for (int column = warp.lane; column < columns; column += Warp::size) {
                const int k = row * columns + column;
                // All that is known before the depth is asked for first: it arrives at once.
                const Ray towards = ray(k);
                const Corners at = corners(row, column);
                const int d = cell(row, column).depth();
                place(k, towards, d);
                box(row, column, at, d, bends);
            }
#else
        (void)team;
        int d[MOST_COLUMNS];
        CellRow beside(near);
        for (int row = 0; row < rows; ++row) {
            depths(row, beside, d);
            for (int column = 0; column < columns; ++column) {
                const int k = row * columns + column;
                place(k, ray(k), d[column]);
            }
            boxes(row, d);
        }
#endif
    }
};

}  // namespace
}  // namespace jaxdet
