// What is known of each label of a frame: how many cells, from where to where.
// Twin of `extents` in jaxdet/reference/_view.py.
#pragma once
#include "lanes.h"
#include "shared_words.h"

struct Extents {
    enum { TRIM = 20, SUMS = 2, LEAST = 10, FIELDS = 19, KNOWN = 15, AHEAD = 2, NONE = 1 << 30 };
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
#if defined(__CUDA_ARCH__)
        // Down the columns, AHEAD cells at a time: their loads wait together.
        for (int column = team.rank; column < columns; column += team.size) {
            Run run(-1, 0, 0);
            for (int row = 0; row < rows; row += AHEAD) {
                int l[AHEAD], x[AHEAD], z[AHEAD], r[AHEAD], f[AHEAD], h[AHEAD], seen[AHEAD];
                for (int k = 0; k < AHEAD; ++k) {
                    const int i = row + k < rows ? (row + k) * columns + column : column;
                    l[k] = row + k < rows ? label[i] : -1;
                    x[k] = at_x[i], z[k] = at_z[i];
                    r[k] = at_right[i], f[k] = at_forward[i], h[k] = at_height[i];
                    seen[k] = in_view[i];
                }
                for (int k = 0; k < AHEAD; ++k) {
                    if (l[k] != run.label) {
                        const int last = row + k - 1;
                        if (run.label >= 0) add(team, run, run.begin, last, column, column);
                        run = Run(l[k], (row + k) * columns + column, row + k);
                    }
                    run.take(x[k], z[k], r[k], f[k], h[k], seen[k]);
                }
            }
            if (run.label >= 0) add(team, run, run.begin, rows - 1, column, column);
        }
#else
        for (int row = 0; row < rows; ++row) {
            const int* own = label + row * columns;
            for (int c = 0, end; c < columns; c = end) {
                const int l = own[c];
                end = c + 1;
                while (end < columns && own[end] == l) ++end;
                if (l < 0) continue;
                Run run(l, row * columns + c, c);
                for (int n = 0; n < end - c; ++n) {
                    const int i = run.first + n;
                    run.take(at_x[i], at_z[i], at_right[i], at_forward[i], at_height[i], in_view[i]);
                }
                add(team, run, row, row, c, end - 1);
            }
        }
#endif
        team.sync();
    }

    // Cells of one label in a line.
    struct Run {
        int label, first, begin, size, seen, x, z, r0, f0, h0, r1, f1, h1;

        // `first`: its first cell; `begin`: where that is in the line.
        Run(int label, int first, int begin)
            : label(label), first(first), begin(begin), size(0), seen(0), x(NONE), z(NONE), r0(NONE),
              f0(NONE), h0(NONE), r1(-NONE), f1(-NONE), h1(-NONE) {}

        void take(int x_here, int z_here, int r, int f, int h, int shown) {
            x = x_here < x ? x_here : x;
            z = z_here < z ? z_here : z;
            r0 = r < r0 ? r : r0;
            r1 = r > r1 ? r : r1;
            f0 = f < f0 ? f : f0;
            f1 = f > f1 ? f : f1;
            h0 = h < h0 ? h : h0;
            h1 = h > h1 ? h : h1;
            seen += shown;
            ++size;
        }
    };

    void add(const Team& team, const Run& run, int row0, int row1, int column0, int column1) const {
        const int l = run.label;
        team.add(cells + l, run.size);
        team.add(shown + l, run.seen);
        team.least(first + l, run.first);
        team.least(row_low + l, row0);
        team.most(row_high + l, row1);
        team.least(column_low + l, column0);
        team.most(column_high + l, column1);
        team.least(right_low + l, run.r0);
        team.most(right_high + l, run.r1);
        team.least(forward_low + l, run.f0);
        team.most(forward_high + l, run.f1);
        team.least(bottom + l, run.h0);
        team.most(top + l, run.h1);
        team.least(nearest + l, run.z);
        team.least(leftmost + l, run.x);
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
    enum { BITS = 7, BUCKETS = 1 << BITS, STATE = 6, AHEAD = 4 };
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
    int* histogram(int l, int end) const {
        const int at = (2 * l + end) * BUCKETS;
#if defined(__CUDA_ARCH__)
        if (at + BUCKETS <= SharedWords::COUNT) return SharedWords::begin() + at;
#endif
        return histograms + at;
    }

    // Ends in a sync.
    void run(const Team& team) const {
        const Lanes lanes(team);
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
            for (int i = lanes.index; i < 2 * count; i += lanes.count) {
                const int l = i >> 1, end = i & 1;
                if (bits(l) >= 0) narrow(lanes, l, end, histogram(l, ends == 1 ? 0 : end));
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

    // Goes to the bucket that holds the cell looked for.
    void narrow([[maybe_unused]] const Lanes& lanes, int l, int end, const int* found) const {
        int bucket = 0, left = below(l)[end];
#if defined(__CUDA_ARCH__)
        enum { EACH = BUCKETS / Lanes::size };
        int own[EACH], sum = 0;
        for (int k = 0; k < EACH; ++k) sum += own[k] = found[lanes.rank * EACH + k];
        int to = sum;
        for (int away = 1; away < Lanes::size; away *= 2) {
            const int before = __shfl_up_sync(0xffffffff, to, away);
            to += lanes.rank >= away ? before : 0;
        }
        // By the lane whose buckets hold it.
        if (left >= to || left < to - sum) return;
        left -= to - sum;
        bucket = lanes.rank * EACH;
        for (int k = 0; k < EACH - 1; ++k) {
            if (left < own[k]) break;
            left -= own[k];
            ++bucket;
        }
#else
        while (left >= found[bucket]) left -= found[bucket++];
#endif
        below(l)[end] = left;
        begin(l)[end] += bucket << bits(l);
    }

    void clear(const Team& team) const {
        const Lanes lanes(team);
        for (int i = lanes.index; i < 2 * count; i += lanes.count) {
            if (bits(i >> 1) < 0) continue;
            int* own = histogram(i >> 1, i & 1);
            for (int k = lanes.rank; k < BUCKETS; k += lanes.size) own[k] = 0;
        }
    }

#if defined(__CUDA_ARCH__)
    // Cells of a column that follow each other in one bucket.
    struct Pending {
        int *place, count;

        void add(const Team& team, int* next) {
            if (next != place) {
                end(team);
                place = next;
                count = 0;
            }
            ++count;
        }
        void end(const Team& team) const {
            if (place) team.add(place, count);
        }
    };

    // Down the columns, AHEAD cells at a time: their loads wait together.
    void fill(const Team& team) const { fill_columns(team, false); }
    void fill_ends(const Team& team) const { fill_columns(team, true); }

    void fill_columns(const Team& team, bool ends) const {
        for (int c = team.rank; c < columns; c += team.size) {
            Pending one = {nullptr, 0}, two = {nullptr, 0};
            int known = -1, from = 0, to = 0, width = -1, range = 31;
            for (int row = 0; row < rows; row += AHEAD) {
                int l[AHEAD], at[AHEAD];
                for (int k = 0; k < AHEAD; ++k) {
                    const int i = row + k < rows ? (row + k) * columns + c : c;
                    l[k] = row + k < rows ? label[i] : -1;
                    at[k] = value[i];
                }
                for (int k = 0; k < AHEAD; ++k) {
                    if (l[k] != known) {
                        known = l[k];
                        width = known < 0 ? -1 : bits(known);
                        if (width >= 0) {
                            from = begin(known)[0];
                            to = begin(known)[1];
                            range = ends ? span(known) : 31;
                        }
                    }
                    if (width < 0) continue;
                    const unsigned a = at[k] - from, b = at[k] - to;
                    if (a >> range == 0) one.add(team, histogram(known, 0) + (a >> width));
                    if (ends && b >> range == 0) two.add(team, histogram(known, 1) + (b >> width));
                }
            }
            one.end(team);
            two.end(team);
        }
    }
#else
    void fill(const Team& team) const {
        for (int row = 0; row < rows; ++row) {
            const int* line = label + row * columns;
            for (int c = 0, end; c < columns; c = end) {
                const int start = row * columns + c, l = line[c];
                end = c + 1;
                while (end < columns && line[end] == l) ++end;
                if (l < 0 || bits(l) < 0) continue;
                const int from = begin(l)[0], width = bits(l);
                int* own = histogram(l, 0);
                for (int n = 0; n < end - c; ++n) {
                    team.add(own + ((value[start + n] - from) >> width), 1);
                }
            }
        }
    }

    void fill_ends(const Team& team) const {
        for (int row = 0; row < rows; ++row) {
            const int* line = label + row * columns;
            for (int c = 0, end; c < columns; c = end) {
                const int start = row * columns + c, l = line[c];
                end = c + 1;
                while (end < columns && line[end] == l) ++end;
                if (l < 0 || bits(l) < 0) continue;
                const int from = begin(l)[0], to = begin(l)[1], width = bits(l), range = span(l);
                int* own = histogram(l, 0);
                for (int n = 0; n < end - c; ++n) {
                    const int at = value[start + n];
                    const unsigned a = at - from, b = at - to;
                    if (a >> range && b >> range) continue;
                    if (a >> range == 0) team.add(own + (a >> width), 1);
                    if (b >> range == 0) team.add(own + BUCKETS + (b >> width), 1);
                }
            }
        }
    }
#endif
};
