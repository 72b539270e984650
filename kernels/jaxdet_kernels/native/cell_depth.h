// The depth of a cell: of the measured depths of its pixels, the mean of those near their median.
// Twin of `_block_depth` in jaxdet/reference/_cells.py.
#pragma once

struct CellDepth {
#if defined(__CUDA_ARCH__)
    enum { MOST = 0 };
#else
    enum { MOST = 64 };  // Values that are sorted; of more, the median is found bit by bit.
#endif
    const unsigned short* first;  // The cell's upper left pixel.
    int stride;                   // From row to row [pixel].
    int side;                     // Of the cell [pixel].
    const int* near;              // By the median: how far from it depths count; never falling.

    int at(int i) const { return first[(i / side) * stride + i % side]; }

    // The k-th smallest of the measured depths, k from 0.
    int smallest(int k) const {
        const int pixels = side * side;
        if (pixels <= MOST) {
            int sorted[MOST + 1], length = 0;
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
        int known = 0;
        for (int bit = 15; bit >= 0; --bit) {
            // Of those that share the known upper bits, how many have a 0 here?
            int zeros = 0;
            for (int i = 0; i < pixels; ++i) {
                const int value = at(i);
                zeros += value && value >> bit == known >> bit;
            }
            if (k >= zeros) {
                k -= zeros;
                known |= 1 << bit;
            }
        }
        return known;
    }

    int depth_of_any() const {
        int count = 0, low = 65536, high = 0;
        long long sum = 0;
        for (int v = 0; v < side; ++v)
            for (int u = 0; u < side; ++u) {
                const int value = first[v * stride + u];
                const int measured = value ? value : 65536;
                count += value != 0;
                sum += value;
                low = measured < low ? measured : low;
                high = value > high ? value : high;
            }
        if (2 * count < side * side || !count) return 0;
        // What is near grows with depth: if the farthest is near the nearest, all are near the
        // median.
        if (high - low > near[low]) {
            const int median = smallest((count - 1) / 2), reach = near[median];
            count = 0;
            sum = 0;
            for (int v = 0; v < side; ++v)
                for (int u = 0; u < side; ++u) {
                    const int value = first[v * stride + u];
                    const int apart = value < median ? median - value : value - median;
                    const bool counts = value && apart <= reach;
                    count += counts;
                    sum += counts ? value : 0;
                }
        }
        return mean(sum, count);
    }

    // Rounded.
    int mean(long long sum, int count) const {
        const bool fits = side < 128;
        return fits ? (int)((2 * (unsigned)sum + count) / (unsigned)(2 * count))
                    : (int)((2 * sum + count) / (2 * count));
    }

#if defined(__CUDA_ARCH__)
    enum { SMALL = 4 };

    // For a side known when this is compiled, at most SMALL: the values stay in registers.
    __forceinline__ int depth_of_small(int known) const {
        const int pixels = known * known;
        int value[SMALL * SMALL];
        for (int v = 0; v < known; ++v)
            for (int u = 0; u < known; ++u) value[v * known + u] = first[v * stride + u];
        int count = 0, sum = 0, low = 65536, high = 0;
        for (int i = 0; i < pixels; ++i) {
            count += value[i] != 0;
            sum += value[i];
            low = value[i] && value[i] < low ? value[i] : low;
            high = value[i] > high ? value[i] : high;
        }
        if (2 * count < pixels || !count) return 0;
        if (high - low > near[low]) {
            // The median: as many are below it as come before it, or fewer, and of its equals one
            // has its place.
            const int place = (count - 1) / 2;
            int median = 0;
            for (int i = 0; i < pixels; ++i) {
                int below = 0, up_to = 0;
                for (int j = 0; j < pixels; ++j) {
                    below += value[j] && value[j] < value[i];
                    up_to += value[j] && value[j] <= value[i];
                }
                if (below <= place && place < up_to) median = value[i];
            }
            const int reach = near[median];
            count = sum = 0;
            for (int i = 0; i < pixels; ++i) {
                const int apart = value[i] < median ? median - value[i] : value[i] - median;
                const bool counts = value[i] && apart <= reach;
                count += counts;
                sum += counts ? value[i] : 0;
            }
        }
        return mean(sum, count);
    }
#endif

    int depth() const {
#if defined(__CUDA_ARCH__)
        if (side == 3) return depth_of_small(3);
        if (side == 4) return depth_of_small(4);
#endif
        return depth_of_any();
    }
};
