// Cells of the depth image: one depth and one 3D position per cell. Twin of jaxdet/reference/_cells.py.
#pragma once
#include "team.h"
#include "cell_depth.h"
#include "warp.h"

namespace jaxdet { namespace {

struct CellGrid {
    enum { RAY_BITS = 20, MOST_COLUMNS = 4096 };
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

#if !defined(__CUDA_ARCH__)
    // Computes the depths of a row of cells, and their smallest measured depths.
    void depths(int row, CellRow& row_depths, int* d) const {
        enum { LANES = CellRow::LANES };
        if (side > CellRow::MOST_SIDE || columns < LANES) {
            for (int column = 0; column < columns; ++column)
                d[column] = cell(row, column).depth(nearest_out + row * columns + column);
            return;
        }
        int* const nearest = nearest_out + row * columns;
        for (int start = 0; start < columns; start += LANES) {
            // The last vector overlaps the one before it if the row is not a multiple of LANES.
            const int from = start < columns - LANES ? start : columns - LANES;
            const unsigned short* first = cell(row, from).first;
            // Prefetches the next row of cells.
            for (int v = side; row + 1 < rows && v < 2 * side; ++v)
                for (int u = 0; u < LANES * side; u += 32) __builtin_prefetch(first + v * width + u);
            switch (side) {
                case 1: row_depths.run(first, width, 1, d + from, nearest + from); break;
                case 2: row_depths.run(first, width, 2, d + from, nearest + from); break;
                case 3: row_depths.run(first, width, 3, d + from, nearest + from); break;
                case 4: row_depths.run(first, width, 4, d + from, nearest + from); break;
                case 5: row_depths.run(first, width, 5, d + from, nearest + from); break;
                default: row_depths.run(first, width, side, d + from, nearest + from);
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
                // Load the ray before computing the depth, so that the latencies of both loads overlap.
                const int ray_x = rays[k], ray_y = rays[all + k];
                place(k, ray_x, ray_y, cell(row, column).depth(nearest_out + k));
            }
#else
        (void)team;
        int d[MOST_COLUMNS];
        CellRow row_depths(near);
        for (int row = 0; row < rows; ++row) {
            depths(row, row_depths, d);
            for (int column = 0; column < columns; ++column) {
                const int k = row * columns + column;
                place(k, rays[k], rays[all + k], d[column]);
            }
        }
#endif
    }
};

} }  // namespace jaxdet
