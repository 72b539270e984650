// Cells of the depth image: one depth and one 3D position per cell. Twin of jaxdet/reference/_cells.py.
#pragma once
#include "cell_depth.h"
#include "team.h"
#include "warp.h"

namespace jaxdet { namespace {

struct CellGrid {
    enum { RAY_BITS = 20 };
    const unsigned short* depth;    // (height, width) depth image
    int width, rows, columns, side;
    const int* near;                // tolerance around the median of a cell, see `CellDepth`
    const int* rays;                // (2, rows, columns) x / z and y / z of cells, RAY_BITS fraction bits
    int *x_out, *y_out, *z_out;
    int* nearest_out;               // smallest measured depth of a cell, 0 = none

    CellDepth cell(int row, int column) const {
        return {depth + (long long)row * side * width + column * side, width, side, near};
    }

    // Product of `ray` and d, rounded, in 32-bit arithmetic: ten fraction bits at a time. Rays are
    // below 2^23.
    static int along(int ray, int d) {
        return ((ray >> 10) * d + (((ray & 1023) * d) >> 10) + 512) >> 10;
    }

    void place(int k, int ray_x, int ray_y, int d) const {
        x_out[k] = along(ray_x, d);
        y_out[k] = along(ray_y, d);
        z_out[k] = d;
    }

    // Computes the cells of the image. Ends in a sync.
    void run(const Team& team) const {
        const Warp warp(team);
        const bool fits = side <= CellRow::MOST_SIDE && columns >= CellRow::LANES;
        const int all = rows * columns, lanes = fits ? (int)CellRow::LANES : 1;
        for (int row = warp.index; row < rows; row += warp.count)
            for (int c = warp.lane * lanes; c < columns; c += warp.size * lanes) {
                // The last vector overlaps the one before it if the row is not a multiple of `lanes`.
                const int column = c < columns - lanes ? c : columns - lanes, k = row * columns + column;
                int d[CellRow::LANES];
                if (fits)
                    depths(row, column, d, nearest_out + k);
                else
                    d[0] = cell(row, column).depth(nearest_out + k);
                JAXDET_VECTORIZE
                for (int i = k; i < k + lanes; ++i)
                    place(i, Team::input(rays + i), Team::input(rays + all + i), d[i - k]);
            }
        team.sync();
    }

    // Computes the depths of CellRow::LANES cells, and their smallest measured depths.
    void depths(int row, int column, int* d, int* nearest) const {
        const unsigned short* const first = cell(row, column).first;
        CellRow cells(near);
#if !defined(__CUDA_ARCH__)
        // Prefetches the next row of cells.
        for (int v = side; row + 1 < rows && v < 2 * side; ++v)
            for (int u = 0; u < CellRow::LANES * side; u += 32) __builtin_prefetch(first + v * width + u);
#endif
        switch (side) {
            case 1: return cells.run(first, width, 1, d, nearest);
            case 2: return cells.run(first, width, 2, d, nearest);
            case 3: return cells.run(first, width, 3, d, nearest);
            case 4: return cells.run(first, width, 4, d, nearest);
#if !defined(__CUDA_ARCH__)
            case 5: return cells.run(first, width, 5, d, nearest);
            default: return cells.run(first, width, side, d, nearest);
#endif
        }
    }
};

} }  // namespace jaxdet
