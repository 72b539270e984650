// Cells of the depth image: one depth each, the place in space, and the box in the colour image.
// Twin of jaxdet/reference/_cells.py.
#pragma once
#include "team.h"
#include "cell_depth.h"
#include "projection.h"

struct CellGrid {
    enum { RAY_BITS = 20, MOST_COLUMNS = 4096 };
    const unsigned short* depth;    // (height, width)
    int width, rows, columns, side;
    const int* near;                // By depth, see `CellDepth`.
    const int* rays;                // (3, rows, columns), RAY_BITS fraction bits.
    const int* offset;              // (3)
    const float *corner_x, *corner_y;  // (height + 1, width + 1)
    Projection projection;
    const int* last;                // The colour image's last column and row.
    bool aligned;
    int *x_out, *y_out, *z_out, *uv_min_out, *uv_max_out;
    bool* in_view_out;

    CellDepth cell(int row, int column) const {
        return {depth + (long long)row * side * width + column * side, width, side, near};
    }

    // `ray d` rounded, in 32 bits: ten fraction bits at a time. Rays are below 2^23.
    static int along(int ray, int d) {
        return ((ray >> 10) * d + (((ray & 1023) * d) >> 10) + 512) >> 10;
    }

    void place(int row, int column, int d) const {
        const int k = row * columns + column, all = rows * columns;
        const int z = along(rays[2 * all + k], d) + offset[2];
        const int seen = -(int)(d > 0 && z > 0);
        x_out[k] = (along(rays[k], d) + offset[0]) & seen;
        y_out[k] = (along(rays[all + k], d) + offset[1]) & seen;
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
        uv_min_out[2 * k] = clamp(low_u, last[0]) & shown;
        uv_min_out[2 * k + 1] = clamp(low_v, last[1]) & shown;
        uv_max_out[2 * k] = clamp(high_u, last[0]) & shown;
        uv_max_out[2 * k + 1] = clamp(high_v, last[1]) & shown;
        in_view_out[k] = inside;
    }

    // Corner 0 or 1 of a cell whose depth is d; `bends` where the lens does.
    Projection::Point corner(int row, int column, int d, int which, bool bends) const {
        const int v = (row + which) * side, u = (column + which) * side;
        if (aligned) return {u - which, v - which, d, true};
        const long long at = (long long)v * (width + 1) + u;
        return projection.through(d, corner_x[at], corner_y[at], bends);
    }

    // Of a row of cells.
    void boxes(int row, const int* d) const {
        const bool bends = projection.model != Projection::PINHOLE;
        if (!aligned && !bends) {
            int u[2][MOST_COLUMNS], v[2][MOST_COLUMNS], seen[2][MOST_COLUMNS];
            for (int which = 0; which < 2; ++which) {
                const long long at = (long long)(row + which) * side * (width + 1) + which * side;
                const float *x = corner_x + at, *y = corner_y + at;
                for (int column = 0; column < columns; ++column) {
                    const Projection::Point there =
                        projection.through(d[column], x[column * side], y[column * side]);
                    u[which][column] = there.u;
                    v[which][column] = there.v;
                    seen[which][column] = there.seen;
                }
            }
            for (int column = 0; column < columns; ++column)
                box(row * columns + column, {u[0][column], v[0][column], 0, seen[0][column] != 0},
                    {u[1][column], v[1][column], 0, seen[1][column] != 0});
            return;
        }
        for (int column = 0; column < columns; ++column)
            box(row * columns + column, corner(row, column, d[column], 0, bends),
                corner(row, column, d[column], 1, bends));
    }

    void run(const Team& team) const {
#if defined(__CUDA_ARCH__)
        for (int k = team.rank; k < rows * columns; k += team.size) {
            const int row = k / columns, column = k - row * columns;
            const int d = cell(row, column).depth();
            const bool bends = projection.model != Projection::PINHOLE;
            place(row, column, d);
            box(k, corner(row, column, d, 0, bends), corner(row, column, d, 1, bends));
        }
#else
        (void)team;
        // Row by row: the pixels of a column of the image first, then the columns of a cell.
        int count[MOST_COLUMNS], sum[MOST_COLUMNS], low[MOST_COLUMNS], high[MOST_COLUMNS];
        int d[MOST_COLUMNS];
        const int used = columns * side;
        for (int row = 0; row < rows; ++row) {
            const unsigned short* line = depth + (long long)row * side * width;
            for (int u = 0; u < used; ++u) {
                const int value = line[u];
                count[u] = value != 0;
                sum[u] = high[u] = value;
                low[u] = value ? value : 65536;
            }
            for (int v = 1; v < side; ++v) {
                line += width;
                for (int u = 0; u < used; ++u) {
                    const int value = line[u], measured = value ? value : 65536;
                    count[u] += value != 0;
                    sum[u] += value;
                    high[u] = value > high[u] ? value : high[u];
                    low[u] = measured < low[u] ? measured : low[u];
                }
            }
            for (int column = 0; column < columns; ++column) {
                CellDepth::Pixels all{0, 0, 65536, 0};
                for (int u = column * side; u < (column + 1) * side; ++u) {
                    all.count += count[u];
                    all.sum += sum[u];
                    all.low = low[u] < all.low ? low[u] : all.low;
                    all.high = high[u] > all.high ? high[u] : all.high;
                }
                cell(row, column).keep_near(all);
                // Those of this cell and of the ones before are read no more.
                count[column] = all.count;
                sum[column] = all.sum;
            }
            for (int column = 0; column < columns; ++column)
                d[column] = CellDepth::mean(sum[column], count[column]);
            for (int column = 0; column < columns; ++column) place(row, column, d[column]);
            boxes(row, d);
        }
#endif
    }
};
