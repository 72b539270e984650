// The depth of a cell: of the measured depths of its pixels, the mean of those near their median.
// Twin of `_block_depth` in jaxdet/reference/_cells.py.
#pragma once

struct CellDepth {
    const unsigned short* first;  // The cell's upper left pixel.
    int stride;                   // From row to row [pixel].
    int side;                     // Of the cell [pixel], at most 128: sums have 31 bits.
    const int* near;              // By the median: how far from it depths count; never falling.

    // What is known of the measured depths of its pixels.
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

    // The k-th smallest of the measured depths, k from 0, between `low` and `high`.
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

    // Leaves what is near the median; a count of 0 where too few are measured.
    void keep_near(Pixels& all) const {
        if (2 * all.count < side * side || !all.count) {
            all.count = all.sum = 0;
            return;
        }
        // What is near grows with depth: if the farthest is near the nearest, all are near the
        // median.
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

    // Rounded, halves up; 0 of nothing. Quotients of such integers are exact to 2^-9, so float64
    // tells those below a whole number from it.
    static int mean(int sum, int count) {
        return count ? (int)((2.0 * sum + count) / (2.0 * count)) : 0;
    }

#if defined(__CUDA_ARCH__)
    enum { SMALL = 4 };

    // For a side known when this is compiled, at most SMALL: the values stay in registers.
    __forceinline__ int depth_of_small(int known) const {
        const int all = known * known;
        int value[SMALL * SMALL], sorted[SMALL * SMALL];
#pragma unroll
        for (int v = 0; v < known; ++v)
#pragma unroll
            for (int u = 0; u < known; ++u) value[v * known + u] = first[v * stride + u];
        int count = 0, sum = 0, high = 0;
#pragma unroll
        for (int i = 0; i < all; ++i) {
            count += value[i] != 0;
            sum += value[i];
            high = value[i] > high ? value[i] : high;
            sorted[i] = value[i] ? value[i] : 65536;
        }
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

    // Batcher's odd-even merge sort; all its loops have a fixed length.
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

    int depth() const {
#if defined(__CUDA_ARCH__)
        if (side == 3) return depth_of_small(3);
        if (side == 4) return depth_of_small(4);
#endif
        Pixels all = pixels();
        keep_near(all);
        return mean(all.sum, all.count);
    }
};

// The same for LANES cells side by side, for the vector units of a CPU: all loops over them have that
// length and no branch. Called with a constant `side`, so that the pixels of a row are dealt out by
// shuffles.
struct CellRow {
    enum { LANES = 64, MOST_SIDE = 8 };
    const int* near;  // As in CellDepth.
    // By place in the cell: depth less one, so that no measurement is more than any depth.
    unsigned short pixel[MOST_SIDE * MOST_SIDE][LANES];
    unsigned short count[LANES], median[LANES];
    int sum[LANES], reach[LANES];

    explicit CellRow(const int* near) : near(near) {}

    // Of a depth less one.
    int near_of(unsigned short one) const { return near[(one + 1) & 65535]; }

    // The depths of the cells whose first pixel is `first`; a side is at most MOST_SIDE.
    __attribute__((always_inline)) inline void run(const unsigned short* first, int stride,
                                                   int side, int* out) {
        const int all = side * side;
        unsigned short low[LANES], high[LANES];
        for (int k = 0; k < LANES; ++k) {
            low[k] = 65535;
            high[k] = 0;
        }
        for (int v = 0; v < side; ++v)
            for (int k = 0; k < LANES; ++k)
                for (int u = 0; u < side; ++u)
                    pixel[v * side + u][k] = (unsigned short)(first[v * stride + k * side + u] - 1);
        for (int p = 0; p < all; ++p)
            for (int k = 0; k < LANES; ++k) {
                const unsigned short one = pixel[p][k], value = (unsigned short)(one + 1);
                low[k] = one < low[k] ? one : low[k];
                high[k] = value > high[k] ? value : high[k];
            }
        // What is near grows with depth: if the farthest is near the nearest, all are near the
        // median, whatever that is.
        int uneven = 0;
        for (int k = 0; k < LANES; ++k) {
            reach[k] = 65535;
            median[k] = low[k];
            uneven |= high[k] - low[k] - 1 > near_of(low[k]);
        }
        add_near(all);
        for (int k = 0; k < LANES; ++k) low[k] = 2 * count[k] >= all;
        if (uneven) {
            find_median(all);
            for (int k = 0; k < LANES; ++k) reach[k] = near_of(median[k]);
            add_near(all);
        }
        for (int k = 0; k < LANES; ++k) out[k] = low[k] ? CellDepth::mean(sum[k], count[k]) : 0;
    }

    // The lower median of `count` depths, from its highest bit on: as many are below it as come
    // before it, or fewer.
    __attribute__((always_inline)) inline void find_median(int all) {
        for (int k = 0; k < LANES; ++k) median[k] = 0;
        for (int bit = 1 << 15; bit; bit >>= 1) {
            unsigned short tried[LANES], below[LANES];
            for (int k = 0; k < LANES; ++k) {
                tried[k] = (unsigned short)(median[k] | bit);
                below[k] = 0;
            }
            for (int p = 0; p < all; ++p)
                for (int k = 0; k < LANES; ++k)
                    below[k] = (unsigned short)(below[k] + (pixel[p][k] < tried[k]));
            for (int k = 0; k < LANES; ++k) {
                const unsigned short twice = (unsigned short)(2 * below[k]);
                median[k] = (unsigned short)(median[k] | (twice < count[k] ? bit : 0));
            }
        }
    }

    // How many depths are within reach of the median, and their sum.
    __attribute__((always_inline)) inline void add_near(int all) {
        unsigned short most[LANES];
        for (int k = 0; k < LANES; ++k) {
            most[k] = (unsigned short)(reach[k] < 65535 ? reach[k] : 65535);
            count[k] = 0;
            sum[k] = 0;
        }
        for (int p = 0; p < all; ++p)
            for (int k = 0; k < LANES; ++k) {
                const unsigned short one = pixel[p][k], other = median[k];
                const unsigned short apart =
                    (unsigned short)(one > other ? one - other : other - one);
                const unsigned short value =
                    (unsigned short)(apart <= most[k] ? one + 1 : 0);
                count[k] = (unsigned short)(count[k] + (value != 0));
                sum[k] += value;
            }
    }
};
