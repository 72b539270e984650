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

#if defined(__CUDA_ARCH__)
    enum { SMALL = 4 };

    // Returns the same as `depth`, for a side that is a compile-time constant of at most SMALL pixels, so
    // that the values stay in registers.
    __forceinline__ int depth_of_small(int constant, int* nearest) const {
        const int all = constant * constant;
        int value[SMALL * SMALL], sorted[SMALL * SMALL];
#pragma unroll
        for (int v = 0; v < constant; ++v)
#pragma unroll
            for (int u = 0; u < constant; ++u) value[v * constant + u] = first[v * stride + u];
        int count = 0, sum = 0, high = 0;
#pragma unroll
        for (int i = 0; i < all; ++i) {
            count += value[i] != 0;
            sum += value[i];
            high = value[i] > high ? value[i] : high;
            sorted[i] = value[i] ? value[i] : 65536;
        }
        int least = 65536;
#pragma unroll
        for (int i = 0; i < all; ++i) least = min(least, sorted[i]);
        *nearest = least & 65535;
        if (2 * count < all || !count) return 0;
        sort(sorted, all);
        if (high - sorted[0] > near[sorted[0]]) {
            const int place = (count - 1) / 2;
            int median = 0;
#pragma unroll
            for (int i = 0; i < all; ++i) median = i == place ? sorted[i] : median;
            const int reach = near[median];
            count = sum = 0;
#pragma unroll
            for (int i = 0; i < all; ++i) {
                const int apart = value[i] < median ? median - value[i] : value[i] - median;
                const bool counts = value[i] && apart <= reach;
                count += counts;
                sum += counts ? value[i] : 0;
            }
        }
        return (2 * sum + count) / (2 * count);
    }

    // Batcher's odd-even merge sort; all loops have a fixed length.
    __forceinline__ void sort(int* values, int all) const {
#pragma unroll
        for (int m = 0; m < 4; ++m)
#pragma unroll
            for (int n = 0; n < 4; ++n)
#pragma unroll
                for (int i = 0; i < SMALL * SMALL; ++i) {
                    if (n > m) continue;
                    const int part = 1 << m, apart = 1 << (m - n), k = i - (n ? apart : 0);
                    if (i + apart >= all || k < 0 || (k & apart)) continue;
                    if (i / (2 * part) != (i + apart) / (2 * part)) continue;
                    const int one = values[i], other = values[i + apart];
                    values[i] = min(one, other);
                    values[i + apart] = max(one, other);
                }
    }
#endif

    // Returns the depth of the cell, 0 if too few of its pixels are measured. Sets `nearest` to its
    // smallest measured depth, 0 if no pixel is measured.
    int depth(int* nearest) const {
#if defined(__CUDA_ARCH__)
        if (side == 3) return depth_of_small(3, nearest);
        if (side == 4) return depth_of_small(4, nearest);
#endif
        Pixels all = pixels();
        *nearest = all.low & 65535;
        keep_near(all);
        return mean(all.sum, all.count);
    }
};

#if !defined(__CUDA_ARCH__)
// CellDepth for LANES adjacent cells at once, in vectors.
struct CellRow {
    typedef Vectors::Words Words;  // one value per cell
    typedef Vectors::Wide Wide;
    enum { LANES = Vectors::SHORTS, MOST_SIDE = 8, NONE = 65535 };
    const int* near;  // tolerance around the median, as in CellDepth
    // Depth minus one of each pixel, indexed by its position in the cell. So a missing measurement is
    // larger than any depth.
    unsigned short pixel[MOST_SIDE * MOST_SIDE][LANES];

    explicit CellRow(const int* near) : near(near) {}

    Words& at(int p) { return *(Words*)pixel[p]; }

    // Tolerance at a depth; `one` is the depth minus one.
    int reach(unsigned short one) const {
        const int reach = near[(one + 1) & 65535];
        return reach < NONE ? reach : (int)NONE;
    }

    // Computes the depths of adjacent cells, the first of which begins at pixel `first`; the side is at
    // most MOST_SIDE. Callers pass a constant side, so that the pixels of a row are distributed by
    // shuffles.
    __attribute__((always_inline)) inline void run(const unsigned short* first, int stride,
                                                   int side, int* out,
                                                   int* nearest) {
        const int all = side * side;
        for (int v = 0; v < side; ++v)
            for (int k = 0; k < LANES; ++k)
                for (int u = 0; u < side; ++u)
                    pixel[v * side + u][k] = (unsigned short)(first[v * stride + k * side + u] - 1);
        Words low = (Words){} - 1, high = {}, count = {};
        for (int p = 0; p < all; ++p) {
            const Words depth = at(p) + 1;
            low = low < at(p) ? low : at(p);
            high = high > depth ? high : depth;
            count -= (Words)(depth != 0);
        }
        *(Wide*)nearest = __builtin_convertvector((Words)(low + 1), Wide);
        const Words enough = (Words)(count * 2 >= (unsigned short)all);
        Wide sum = {};
        if (are_uneven(low, high)) {
            sort(all);
            Words median = at(0);
            for (int p = 1; p <= (all - 1) / 2; ++p)
                median = (count - 1) / 2 == (unsigned short)p ? at(p) : median;
            unsigned short medians[LANES], reaches[LANES];
            *(Words*)medians = median;
            for (int k = 0; k < LANES; ++k) reaches[k] = (unsigned short)reach(medians[k]);
            const Words most_apart = *(Words*)reaches;
            count = (Words){};
            for (int p = 0; p < all; ++p) {
                const Words apart = at(p) > median ? at(p) - median : median - at(p);
                const Words depth = apart <= most_apart ? at(p) + 1 : (Words){};
                count -= (Words)(depth != 0);
                sum += __builtin_convertvector(depth, Wide);
            }
        } else {
            for (int p = 0; p < all; ++p)
                sum += __builtin_convertvector((Words)(at(p) + 1), Wide);
        }
        // The mean is rounded to the nearest integer, halves up. The quotients are at least 2^-7 below
        // the next integer, so float32 never rounds them up to it.
        const Wide parts = __builtin_convertvector(count, Wide);
        const Vectors::WideFloats mean =
            __builtin_convertvector(sum * 2 + parts, Vectors::WideFloats)
            / __builtin_convertvector(parts ? parts * 2 : 1, Vectors::WideFloats);
        const Wide depth = __builtin_convertvector(mean, Wide);
        *(Wide*)out = __builtin_convertvector(enough, Wide) ? depth : (Wide){};
    }

    // Whether some depths of a cell may lie outside the tolerance of its median. If the farthest depth
    // is within the tolerance of the nearest, none does, because the tolerance grows with depth.
    bool are_uneven(const Words& low, const Words& high) const {
        const Words spread = high > low ? high - low : (Words){};
        const int widest = NONE - Vectors::least(~spread);
        return widest - 1 > reach(Vectors::least(low));
    }

    // Sorts the pixels of each cell by depth with Batcher's odd-even merge sort. Loops over many pixels
    // are not unrolled, and clang's warning about that is ignored.
    __attribute__((always_inline)) inline void sort(int all) {
#if defined(__clang__)
#pragma clang diagnostic ignored "-Wpass-failed"
#pragma clang loop unroll(full)
#endif
        for (int part = 1; part < all; part *= 2)
#if defined(__clang__)
#pragma clang loop unroll(full)
#endif
            for (int apart = part; apart; apart /= 2)
#if defined(__clang__)
#pragma clang loop unroll(full)
#endif
                for (int k = apart % part; k + apart < all; ++k) {
                    // A step compares positions of every second group of `apart`, both in the same
                    // pair of parts.
                    if ((k - apart % part) & apart || (k ^ (k + apart)) >= 2 * part) continue;
                    const Words one = at(k), other = at(k + apart);
                    at(k) = one < other ? one : other;
                    at(k + apart) = one < other ? other : one;
                }
    }
};
#endif

} }  // namespace jaxdet
