// Cells of the depth image: one depth each, and its place in space.
// Twin of jaxdet/reference/_cells.py.
#pragma once
#include "team.h"
#include "cell_depth.h"
#include "warp.h"

namespace jaxdet { namespace {

struct CellGrid {
    enum { RAY_BITS = 20, MOST_COLUMNS = 4096 };
    const unsigned short* depth;    // (height, width)
    int width, rows, columns, side;
    const int* near;                // By depth, see `CellDepth`.
    const int* rays;                // (2, rows, columns), x and y over z with RAY_BITS fraction bits.
    int *x_out, *y_out, *z_out;
    int* nearest_out;               // The least measured depth of a cell, 0 = none.

    CellDepth cell(int row, int column) const {
        return {depth + (long long)row * side * width + column * side, width, side, near};
    }

    // `ray d` rounded, in 32 bits: ten fraction bits at a time. Rays are below 2^23.
    static int along(int ray, int d) {
        return ((ray >> 10) * d + (((ray & 1023) * d) >> 10) + 512) >> 10;
    }

    void place(int k, int ray_x, int ray_y, int d) const {
        x_out[k] = along(ray_x, d);
        y_out[k] = along(ray_y, d);
        z_out[k] = d;
    }

#if !defined(__CUDA_ARCH__)
    // Of a row of cells.
    void depths(int row, CellRow& beside, int* d) const {
        enum { LANES = CellRow::LANES };
        if (side > CellRow::MOST_SIDE || columns < LANES) {
            for (int column = 0; column < columns; ++column)
                d[column] = cell(row, column).depth(nearest_out + row * columns + column);
            return;
        }
        int* const nearest = nearest_out + row * columns;
        for (int start = 0; start < columns; start += LANES) {
            // The last ones are found again where they don't fill the lanes.
            const int from = start < columns - LANES ? start : columns - LANES;
            const unsigned short* first = cell(row, from).first;
            // Those of the next row of cells are on their way meanwhile.
            for (int v = side; row + 1 < rows && v < 2 * side; ++v)
                for (int u = 0; u < LANES * side; u += 32) __builtin_prefetch(first + v * width + u);
            switch (side) {
                case 1: beside.run(first, width, 1, d + from, nearest + from); break;
                case 2: beside.run(first, width, 2, d + from, nearest + from); break;
                case 3: beside.run(first, width, 3, d + from, nearest + from); break;
                case 4: beside.run(first, width, 4, d + from, nearest + from); break;
                case 5: beside.run(first, width, 5, d + from, nearest + from); break;
                default: beside.run(first, width, side, d + from, nearest + from);
            }
        }
    }
#endif

    void run(const Team& team) const {
        const int all = rows * columns;
#if defined(__CUDA_ARCH__)
        const Warp warp(team);
        for (int row = warp.index; row < rows; row += warp.count)
            for (int column = warp.lane; column < columns; column += Warp::size) {
                const int k = row * columns + column;
                // The ray is requested before the depth is computed: both loads wait together.
                const int ray_x = rays[k], ray_y = rays[all + k];
                place(k, ray_x, ray_y, cell(row, column).depth(nearest_out + k));
            }
#else
        (void)team;
        int d[MOST_COLUMNS];
        CellRow beside(near);
        for (int row = 0; row < rows; ++row) {
            depths(row, beside, d);
            for (int column = 0; column < columns; ++column) {
                const int k = row * columns + column;
                place(k, rays[k], rays[all + k], d[column]);
            }
        }
#endif
    }
};

} }  // namespace jaxdet
