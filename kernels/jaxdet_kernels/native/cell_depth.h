// The depth of a cell: of the measured depths of its pixels, the mean of those near their median.
// Twin of `_block_depth` in jaxdet/reference/_cells.py.
#pragma once

struct CellDepth {
    enum { MOST = 64 };  // Values that are sorted; of more, the median is found bit by bit.
    const unsigned short* first;  // The cell's upper left pixel.
    int stride;                   // From row to row [pixel].
    int side;                     // Of the cell [pixel].
    const int* near;              // By the median: how far from it depths count; never falling.

    int at(int i) const { return first[(i / side) * stride + i % side]; }

    // The k-th smallest of the measured depths, k from 0.
    int smallest(int k) const {
        const int pixels = side * side;
        if (pixels <= MOST) {
            int sorted[MOST], length = 0;
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

    int depth() const {
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
        return (int)((2 * sum + count) / (2 * count));
    }
};
