// What is known of each label of a frame: how many cells, from where to where.
// Twin of `extents` in jaxdet/reference/_view.py.
#pragma once
#include "team.h"

// The lines of a frame that threads walk along: rows on the CPU, where one thread reads cell after
// cell, and columns on CUDA, where neighbouring threads read neighbouring cells.
struct Lines {
    int count, length, stride, step;

    Lines(int rows, int columns) {
#if defined(__CUDA_ARCH__)
        count = columns, length = rows, stride = 1, step = columns;
#else
        count = rows, length = columns, stride = columns, step = 1;
#endif
    }
};

struct Extents {
    enum { TRIM = 20, SUMS = 2, LEAST = 10, FIELDS = 19, KNOWN = 15, NONE = 1 << 30 };
    int slots, *words;
    // Each of `slots` labels. `first` is the first cell in row-major order; `low` and `high` are the
    // extremes, `left`, `right`, `near` and `far` those of `right` and `forward` but for a
    // twentieth of the cells; `shown` counts the cells in the colour image.
    int *cells, *first, *row_low, *row_high, *column_low, *column_high;
    int *right_low, *right_high, *forward_low, *forward_high, *bottom, *top, *nearest, *leftmost;
    int *shown, *left, *right, *near, *far;

    // `place`: room for FIELDS arrays.
    void lay(int* place, int labels) {
        slots = labels;
        words = place;
        // Sums, then the least, then the most of all cells, then what is trimmed.
        int** each[] = {&cells, &shown, &first, &row_low, &column_low, &right_low, &forward_low,
                        &bottom, &nearest, &leftmost, &row_high, &column_high, &right_high,
                        &forward_high, &top, &left, &right, &near, &far};
        for (int k = 0; k < FIELDS; ++k) *each[k] = place + k * slots;
    }

    int rows_of(int l) const { return row_high[l] - row_low[l] + 1; }
    int columns_of(int l) const { return column_high[l] - column_low[l] + 1; }
    int width(int l) const { return right[l] - left[l]; }
    int depth(int l) const { return far[l] - near[l]; }
    int height(int l) const { return top[l] - bottom[l]; }

    void clear(const Team& team, int count) const {
        for (int l = team.rank; l < count; l += team.size) {
            for (int k = 0; k < KNOWN; ++k) {
                words[k * slots + l] = k < SUMS ? 0 : k < LEAST ? NONE : -NONE;
            }
        }
        team.sync();
    }

    // Everything but the trimmed extremes, from the cells. Ends in a sync.
    void measure(
        const Team& team, int count, const int* label, int rows, int columns, const int* at_x,
        const int* at_z, const int* at_right, const int* at_forward, const int* at_height,
        const unsigned char* in_view
    ) const {
        clear(team, count);
        const Lines lines(rows, columns);
        for (int line = team.rank; line < lines.count; line += team.size) {
            const int base = line * lines.stride;
            for (int k = 0, end; k < lines.length; k = end) {
                const int start = base + k * lines.step, l = label[start];
                end = k + 1;
                while (end < lines.length && label[base + end * lines.step] == l) ++end;
                if (l < 0) continue;
                int seen = 0, x = NONE, z = NONE, r0 = NONE, f0 = NONE, h0 = NONE;
                int r1 = -NONE, f1 = -NONE, h1 = -NONE;
                for (int n = 0; n < end - k; ++n) {
                    const int i = start + n * lines.step;
                    const int r = at_right[i], f = at_forward[i], h = at_height[i];
                    x = at_x[i] < x ? at_x[i] : x;
                    z = at_z[i] < z ? at_z[i] : z;
                    r0 = r < r0 ? r : r0;
                    r1 = r > r1 ? r : r1;
                    f0 = f < f0 ? f : f0;
                    f1 = f > f1 ? f : f1;
                    h0 = h < h0 ? h : h0;
                    h1 = h > h1 ? h : h1;
                    seen += in_view[i];
                }
#if defined(__CUDA_ARCH__)
                const int row0 = k, row1 = end - 1, column0 = line, column1 = line;
#else
                const int row0 = line, row1 = line, column0 = k, column1 = end - 1;
#endif
                team.add(cells + l, end - k);
                team.add(shown + l, seen);
                team.least(first + l, start);
                team.least(row_low + l, row0);
                team.most(row_high + l, row1);
                team.least(column_low + l, column0);
                team.most(column_high + l, column1);
                team.least(right_low + l, r0);
                team.most(right_high + l, r1);
                team.least(forward_low + l, f0);
                team.most(forward_high + l, f1);
                team.least(bottom + l, h0);
                team.most(top + l, h1);
                team.least(nearest + l, z);
                team.least(leftmost + l, x);
            }
        }
        team.sync();
    }

    // The same, from those of parts: part `l` belongs to `whole[l]`. Ends in a sync.
    void join(const Team& team, int count, const Extents& parts, int of, const int* whole) const {
        clear(team, count);
        for (int l = team.rank; l < of; l += team.size) {
            for (int k = 0; k < KNOWN; ++k) {
                const int value = parts.words[k * parts.slots + l];
                int* place = words + k * slots + whole[l];
                if (k < SUMS) team.add(place, value);
                else if (k < LEAST) team.least(place, value);
                else team.most(place, value);
            }
        }
        team.sync();
    }
};

// The k-th smallest and the k-th largest value of each label, by histograms of ever narrower ranges.
struct Trimmed {
    enum { BITS = 7, BUCKETS = 1 << BITS, STATE = 6 };
    int count, rows, columns;
    const int *label, *value;  // of each cell
    // Of each label: how many cells it has, its extremes, and how many cells to pass over at either
    // end; where that is 0 the results are the extremes.
    const int *cells, *low, *high, *over;
    int *least, *most;        // results
    int *state, *histograms;  // STATE words and 2 histograms a label

    // Where the bucket of an end begins, and how many cells of it lie below.
    int* begin(int l) const { return state + STATE * l; }
    int* below(int l) const { return state + STATE * l + 2; }
    // The binary logarithms of a bucket's width, -1 when done, and of that of the last round.
    int& bits(int l) const { return state[STATE * l + 4]; }
    int& span(int l) const { return state[STATE * l + 5]; }
    int* histogram(int l, int end) const { return histograms + (2 * l + end) * BUCKETS; }

    // Ends in a sync.
    void run(const Team& team) const {
        bool open = false;
        for (int l = team.rank; l < count; l += team.size) {
            least[l] = low[l];
            most[l] = high[l];
            bits(l) = -1;
            if (over[l] <= 0) continue;
            open = true;
            bits(l) = 0;
            while ((high[l] - low[l]) >> bits(l) >= BUCKETS) ++bits(l);
            begin(l)[0] = begin(l)[1] = low[l];
            below(l)[0] = over[l];
            below(l)[1] = cells[l] - 1 - over[l];
        }
        // In the first round the ends of a label have one histogram: all its values lie in it.
        for (int ends = 1; team.any(open); ends = 2) {
            clear(team);
            team.sync();
            if (ends == 1) fill(team);
            else fill_ends(team);
            team.sync();
            for (int i = team.rank; i < 2 * count; i += team.size) {
                const int l = i >> 1, end = i & 1;
                if (bits(l) < 0) continue;
                const int* found = histogram(l, ends == 1 ? 0 : end);
                int bucket = 0, left = below(l)[end];
                while (left >= found[bucket]) left -= found[bucket++];
                below(l)[end] = left;
                begin(l)[end] += bucket << bits(l);
            }
            team.sync();
            open = false;
            for (int l = team.rank; l < count; l += team.size) {
                const int width = bits(l);
                if (width > 0) {
                    span(l) = width;
                    bits(l) = width > BITS ? width - BITS : 0;
                    open = true;
                } else if (width == 0) {
                    least[l] = begin(l)[0];
                    most[l] = begin(l)[1];
                    bits(l) = -1;
                }
            }
        }
    }

    void clear(const Team& team) const {
        for (int i = team.rank; i < 2 * count; i += team.size) {
            if (bits(i >> 1) < 0) continue;
            int* own = histograms + i * BUCKETS;
            for (int k = 0; k < BUCKETS; ++k) own[k] = 0;
        }
    }

    void fill(const Team& team) const {
        const Lines lines(rows, columns);
        for (int line = team.rank; line < lines.count; line += team.size) {
            const int base = line * lines.stride;
            for (int k = 0, end; k < lines.length; k = end) {
                const int start = base + k * lines.step, l = label[start];
                end = k + 1;
                while (end < lines.length && label[base + end * lines.step] == l) ++end;
                if (l < 0 || bits(l) < 0) continue;
                const int from = begin(l)[0], width = bits(l);
                int* own = histogram(l, 0);
                for (int n = 0; n < end - k; ++n) {
                    team.add(own + ((value[start + n * lines.step] - from) >> width), 1);
                }
            }
        }
    }

    void fill_ends(const Team& team) const {
        const Lines lines(rows, columns);
        for (int line = team.rank; line < lines.count; line += team.size) {
            const int base = line * lines.stride;
            for (int k = 0, end; k < lines.length; k = end) {
                const int start = base + k * lines.step, l = label[start];
                end = k + 1;
                while (end < lines.length && label[base + end * lines.step] == l) ++end;
                if (l < 0 || bits(l) < 0) continue;
                const int from = begin(l)[0], to = begin(l)[1], width = bits(l), range = span(l);
                int* own = histogram(l, 0);
                for (int n = 0; n < end - k; ++n) {
                    const int at = value[start + n * lines.step];
                    const unsigned a = at - from, b = at - to;
                    if (a >> range && b >> range) continue;
                    if (a >> range == 0) team.add(own + (a >> width), 1);
                    if (b >> range == 0) team.add(own + BUCKETS + (b >> width), 1);
                }
            }
        }
    }
};
