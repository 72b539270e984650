// Cells of the depth image: one depth and one 3D position per cell. The depth of a cell is the mean of
// its measured depths that are close to their median. Twin of jaxdet/reference/_cells.py.
#pragma once
#include "vectors.h"
#include "warp.h"

namespace jaxdet { namespace {

// Depths of LANES adjacent cells of up to MOST_SIDE x MOST_SIDE pixels, in vectors. On CUDA this is one
// cell per thread, whose pixels stay in registers.
struct CellRow {
    typedef Vectors::Words Words;  // one value per cell
    typedef Vectors::Wide Wide;
    enum { LANES = Vectors::SHORTS, MOST_SIDE = LANES > 1 ? 8 : 4 };
    static constexpr Vectors::Word NONE = 65535;
    const int* near;  // tolerance around the median, as in CellGrid
    // Depth minus one of each pixel, by its position in the cell. In 16 bits a missing measurement, 0,
    // becomes 65535, which is larger than any depth.
    Vectors::Word pixel[MOST_SIDE * MOST_SIDE][LANES];

    explicit __attribute__((always_inline)) CellRow(const int* near) : near(near) {}

    __attribute__((always_inline)) Words& at(int p) { return *(Words*)pixel[p]; }

    // Tolerance around a depth; `one` is this depth minus one.
    int reach(unsigned one) const {
        const int reach = near[(one + 1) & 65535];
        return reach < (int)NONE ? reach : (int)NONE;
    }

    // Computes the depths of adjacent cells, the first of which begins at pixel `first`; the side is at
    // most MOST_SIDE. Callers pass a constant side, so that the compiler distributes the pixels of a row
    // by shuffles or, on CUDA, unrolls the loops.
    __attribute__((always_inline)) void run(const unsigned short* first, int stride, int side, int* out,
                                            int* nearest) {
        const int all = side * side;
        JAXDET_UNROLL_ON_CUDA
        for (int v = 0; v < side; ++v)
            for (int k = 0; k < LANES; ++k)
                JAXDET_UNROLL_ON_CUDA
                for (int u = 0; u < side; ++u)
                    pixel[v * side + u][k] = (unsigned short)(first[v * stride + k * side + u] - 1);
        const Words zero = {}, one = zero + 1;
        Words low = zero + NONE, high = zero, count = zero;
        JAXDET_UNROLL_ON_CUDA
        for (int p = 0; p < all; ++p) {
            const Words less = at(p), depth = (less + 1) & NONE;
            low = low < less ? low : less;
            high = high > depth ? high : depth;
            count += depth != 0 ? one : zero;
        }
        Wide sum = {}, parts, depth;
        Vectors::widen((low + 1) & NONE, (Wide*)nearest);
        const Words enough = count * 2 >= (Vectors::Word)all ? one : zero;
        if (are_uneven(low, high)) {
            sort(all);
            Words median = at(0);
            JAXDET_UNROLL_ON_CUDA
            for (int p = 1; p <= (all - 1) / 2; ++p) {
                const Words less = at(p);
                median = (count - 1) / 2 == (Vectors::Word)p ? less : median;
            }
            Vectors::Word reaches[LANES];
            *(Words*)reaches = median;
            for (int k = 0; k < LANES; ++k) reaches[k] = (Vectors::Word)reach(reaches[k]);
            const Words most_apart = *(Words*)reaches;
            count = zero;
            JAXDET_UNROLL_ON_CUDA
            for (int p = 0; p < all; ++p) {
                const Words less = at(p), apart = less > median ? less - median : median - less;
                const Words counted = apart <= most_apart ? (less + 1) & NONE : zero;
                count += counted != 0 ? one : zero;
                Vectors::widen(counted, &depth);
                sum += depth;
            }
        } else {
            JAXDET_UNROLL_ON_CUDA
            for (int p = 0; p < all; ++p) {
                Vectors::widen((at(p) + 1) & NONE, &depth);
                sum += depth;
            }
        }
        // The mean is rounded to the nearest integer, halves up. The quotients are at least 2^-7 below
        // the next integer, so float32 never rounds them up to it.
        Vectors::widen(count, &parts);
        Vectors::divide(sum * 2 + parts, parts ? parts * 2 : 1, &depth);
        Vectors::widen(enough, &parts);
        *(Wide*)out = depth * parts;
    }

    // Whether some depths of a cell may lie outside the tolerance of its median. If the farthest depth
    // is within the tolerance of the nearest, none does, because the tolerance grows with depth.
    __attribute__((always_inline)) bool are_uneven(const Words& low, const Words& high) const {
        const Words zero = {}, spread = high > low ? high - low : zero;
        const int widest = (int)NONE - Vectors::least(NONE - spread);
        return widest - 1 > reach(Vectors::least(low));
    }

    // Sorts the pixels of each cell by depth with Batcher's odd-even merge sort. Loops over many pixels
    // are not unrolled, and clang's warning about that is ignored.
    __attribute__((always_inline)) void sort(int all) {
#if defined(__CUDA_ARCH__)
        // NVRTC unrolls only loops with constant bounds.
        JAXDET_UNROLL
        for (int m = 0; m < 4; ++m)
            JAXDET_UNROLL
            for (int n = 3; n >= 0; --n)
                JAXDET_UNROLL
                for (int k = 0; k < MOST_SIDE * MOST_SIDE; ++k)
                    if (n <= m) exchange(k, 1 << m, 1 << n, all);
#else
#if defined(__clang__)
#pragma clang diagnostic ignored "-Wpass-failed"
#endif
        JAXDET_UNROLL
        for (int part = 1; part < all; part *= 2)
            JAXDET_UNROLL
            for (int apart = part; apart; apart /= 2)
                JAXDET_UNROLL
                for (int k = 0; k + apart < all; ++k) exchange(k, part, apart, all);
#endif
    }

    // Sorts pixels k and k + apart if this step of the sort compares them: k is in an even group of
    // `apart` positions, and both pixels are in the same two parts of `part` positions.
    __attribute__((always_inline)) void exchange(int k, int part, int apart, int all) {
        const int first = apart % part;
        if (k < first || k + apart >= all) return;
        if ((k - first) & apart || (k ^ (k + apart)) >= 2 * part) return;
        const Words one = at(k), other = at(k + apart);
        at(k) = one < other ? one : other;
        at(k + apart) = one < other ? other : one;
    }
};

struct CellGrid {
    enum { RAY_BITS = 20 };
    const unsigned short* depth;    // (height, width) depth image
    int width, rows, columns;
    int side;                       // side of a cell [pixel], at most 128, so that sums fit in 31 bits
    const int* near;                // tolerance around a median, by median; it increases [depth units]
    const int* rays;                // (2, rows, columns) x / z and y / z of cells, RAY_BITS fraction bits
    int *x_out, *y_out, *z_out;
    int* nearest_out;               // smallest measured depth of a cell, 0 = none

    // Upper left pixel of a cell.
    const unsigned short* first_pixel(int row, int column) const {
        return depth + (long long)row * side * width + column * side;
    }

    // Calls `use` with each measured depth of the cell that begins at pixel `first`.
    template <class Use> void each_depth(const unsigned short* first, Use use) const {
        for (int v = 0; v < side; ++v)
            for (int u = 0; u < side; ++u)
                if (const int value = first[v * width + u]) use(value);
    }

    // Returns the depth of the cell that begins at pixel `first`, 0 if fewer than half of its pixels are
    // measured. Sets `nearest` to its smallest measured depth, 0 if no pixel is measured.
    int depth_of(const unsigned short* first, int* nearest) const {
        int count = 0, sum = 0, low = 65536, high = 0;
        each_depth(first, [&](int value) {
            ++count;
            sum += value;
            low = value < low ? value : low;
            high = value > high ? value : high;
        });
        *nearest = low & 65535;
        if (2 * count < side * side) return 0;
        // The tolerance grows with depth: if the farthest depth is within that of the nearest, all
        // depths are within that of the median.
        if (high - low > near[low]) {
            const int rank = (count - 1) / 2;
            while (low < high) {  // finds the median by bisection
                const int middle = (low + high) >> 1;
                int at_most = 0;
                each_depth(first, [&](int value) { at_most += value <= middle; });
                if (at_most > rank)
                    high = middle;
                else
                    low = middle + 1;
            }
            const int median = low, reach = near[median];
            count = sum = 0;
            each_depth(first, [&](int value) {
                const bool counts = (value < median ? median - value : value - median) <= reach;
                count += counts;
                sum += counts ? value : 0;
            });
        }
        // The mean is rounded to the nearest integer, halves up. The quotients are at least 2^-9 below
        // the next integer, so float64 never rounds them up to it.
        return (int)((2.0 * sum + count) / (2.0 * count));
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
                    d[0] = depth_of(first_pixel(row, column), nearest_out + k);
                JAXDET_VECTORIZE
                for (int i = k; i < k + lanes; ++i)
                    place(i, Team::input(rays + i), Team::input(rays + all + i), d[i - k]);
            }
        team.sync();
    }

    // Computes the depths of CellRow::LANES cells, and their smallest measured depths.
    void depths(int row, int column, int* d, int* nearest) const {
        const unsigned short* const first = first_pixel(row, column);
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
