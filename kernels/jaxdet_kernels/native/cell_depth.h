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
#if !defined(__CUDA_ARCH__)
        enum { FEW = 64 };
        if (side * side <= FEW) {
            int sorted[FEW], length = 0;
            for (int v = 0; v < side; ++v)
                for (int u = 0; u < side; ++u) {
                    const int value = first[v * stride + u];
                    if (!value) continue;
                    int j = length++;
                    for (; j > 0 && sorted[j - 1] > value; --j) sorted[j] = sorted[j - 1];
                    sorted[j] = value;
                }
            return sorted[k];
        }
#endif
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
        int value[SMALL * SMALL];
        for (int v = 0; v < known; ++v)
            for (int u = 0; u < known; ++u) value[v * known + u] = first[v * stride + u];
        int count = 0, sum = 0, low = 65536, high = 0;
        for (int i = 0; i < all; ++i) {
            count += value[i] != 0;
            sum += value[i];
            low = value[i] && value[i] < low ? value[i] : low;
            high = value[i] > high ? value[i] : high;
        }
        if (2 * count < all || !count) return 0;
        if (high - low > near[low]) {
            // As many are below the median as come before it, or fewer, and of its equals one has
            // its place.
            const int place = (count - 1) / 2;
            int median = 0;
            for (int i = 0; i < all; ++i) {
                int below = 0, up_to = 0;
                for (int j = 0; j < all; ++j) {
                    below += value[j] && value[j] < value[i];
                    up_to += value[j] && value[j] <= value[i];
                }
                if (below <= place && place < up_to) median = value[i];
            }
            const int reach = near[median];
            count = sum = 0;
            for (int i = 0; i < all; ++i) {
                const int apart = value[i] < median ? median - value[i] : value[i] - median;
                const bool counts = value[i] && apart <= reach;
                count += counts;
                sum += counts ? value[i] : 0;
            }
        }
        return (2 * sum + count) / (2 * count);
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
