// Depth of a cell: the mean of its measured depths that are close to their median. Twin of
// `_block_depth` in jaxdet/reference/_cells.py.
#pragma once
#include "vectors.h"

namespace jaxdet { namespace {

struct CellDepth {
    const unsigned short* first;  // upper left pixel of the cell
    int stride;                   // distance between rows [pixel]
    int side;                     // side of the cell [pixel], at most 128, so that sums fit in 31 bits
    const int* near;              // tolerance around each median [depth units]; it grows with the median

    // Statistics of the measured depths of a cell.
    struct Pixels {
        int count, sum, low, high;
    };

    Pixels pixels() const {
        Pixels all{0, 0, 65536, 0};
        for (int v = 0; v < side; ++v)
            for (int u = 0; u < side; ++u) {
                const int value = first[v * stride + u], measured = value ? value : 65536;
                all.count += value != 0;
                all.sum += value;
                all.low = measured < all.low ? measured : all.low;
                all.high = value > all.high ? value : all.high;
            }
        return all;
    }

    // Returns the k-th smallest measured depth, k from 0, which must lie between `low` and `high`.
    int smallest(int k, int low, int high) const {
        // Bisection.
        while (low < high) {
            const int middle = (low + high) >> 1;
            int at_most = 0;
            for (int v = 0; v < side; ++v)
                for (int u = 0; u < side; ++u) {
                    const int value = first[v * stride + u];
                    at_most += value && value <= middle;
                }
            if (at_most > k)
                high = middle;
            else
                low = middle + 1;
        }
        return low;
    }

    // Restricts the statistics to depths within the tolerance of the median; the count becomes 0 if
    // fewer than half of the pixels are measured.
    void keep_near(Pixels& all) const {
        if (2 * all.count < side * side || !all.count) {
            all.count = all.sum = 0;
            return;
        }
        // The tolerance grows with depth: if the farthest depth is within that of the nearest, all
        // depths are within that of the median.
        if (all.high - all.low <= near[all.low]) return;
        const int median = smallest((all.count - 1) / 2, all.low, all.high), reach = near[median];
        all.count = all.sum = 0;
        for (int v = 0; v < side; ++v)
            for (int u = 0; u < side; ++u) {
                const int value = first[v * stride + u];
                const int apart = value < median ? median - value : value - median;
                const int counts = -(int)(value && apart <= reach);
                all.count -= counts;
                all.sum += value & counts;
            }
    }

    // Mean of the depths, rounded to the nearest integer, halves up; 0 if the count is 0. The quotients
    // are at least 2^-9 below the next integer, so float64 never rounds them up to it.
    static int mean(int sum, int count) {
        return count ? (int)((2.0 * sum + count) / (2.0 * count)) : 0;
    }

    // Returns the depth of the cell, 0 if too few of its pixels are measured. Sets `nearest` to its
    // smallest measured depth, 0 if no pixel is measured.
    int depth(int* nearest) const {
        Pixels all = pixels();
        *nearest = all.low & 65535;
        keep_near(all);
        return mean(all.sum, all.count);
    }
};

// CellDepth for LANES adjacent cells at once, in vectors. On CUDA this is one cell per thread, whose
// pixels stay in registers.
struct CellRow {
    typedef Vectors::Words Words;  // one value per cell
    typedef Vectors::Wide Wide;
    enum { LANES = Vectors::SHORTS, MOST_SIDE = LANES > 1 ? 8 : 4 };
    static constexpr Vectors::Word NONE = 65535;
    const int* near;  // tolerance around the median, as in CellDepth
    // Depth minus one of each pixel, in 16 bits, indexed by its position in the cell. So a missing
    // measurement is larger than any depth.
    Vectors::Word pixel[MOST_SIDE * MOST_SIDE][LANES];

    explicit __attribute__((always_inline)) CellRow(const int* near) : near(near) {}

    __attribute__((always_inline)) Words& at(int p) { return *(Words*)pixel[p]; }

    // Tolerance at a depth; `one` is the depth minus one.
    int reach(unsigned one) const {
        const int reach = near[(one + 1) & 65535];
        return reach < (int)NONE ? reach : (int)NONE;
    }

    // Computes the depths of adjacent cells, the first of which begins at pixel `first`; the side is at
    // most MOST_SIDE. Callers pass a constant side, so that the pixels of a row are distributed by
    // shuffles, or on CUDA that the loops are unrolled.
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

    // Sorts pixels k and k + apart. A step of the sort compares positions of every second group of
    // `apart`, both in the same pair of parts.
    __attribute__((always_inline)) void exchange(int k, int part, int apart, int all) {
        const int first = apart % part;
        if (k < first || k + apart >= all) return;
        if ((k - first) & apart || (k ^ (k + apart)) >= 2 * part) return;
        const Words one = at(k), other = at(k + apart);
        at(k) = one < other ? one : other;
        at(k + apart) = one < other ? other : one;
    }
};

} }  // namespace jaxdet
