// Extents of each label of a frame: number of cells, and ranges in the image and in space. Twin of
// `extents` in jaxdet/reference/_view.py.
#pragma once
#include "cell_list.h"
#include "ranks.h"
#include "warp.h"

namespace jaxdet { namespace {

struct Extents {
    enum { TRIM = 20, SUMS = 1, LEAST = 9, FIELDS = 18, UNTRIMMED = 14, NONE = 1 << 30 };
    int slots, *words;
    // Arrays of `slots` values, one per label. `first` is the first cell in row-major order; `low` and
    // `high` are minima and maxima; `left`, `right`, `near` and `far` are the extremes of `right` and
    // `forward` without a twentieth of the cells at each end.
    int *cells, *first, *row_low, *row_high, *column_low, *column_high;
    int *right_low, *right_high, *forward_low, *forward_high, *bottom, *top, *nearest, *leftmost;
    int *left, *right, *near, *far;

    // Sets the arrays in `place`, which has room for FIELDS arrays of `labels` values.
    void allocate(int* place, int labels) {
        slots = labels;
        words = place;
        // The arrays are in the order: sums, minima, maxima, trimmed extremes.
        int** each[] = {&cells, &first, &row_low, &column_low, &right_low, &forward_low,
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
            for (int k = 0; k < UNTRIMMED; ++k) {
                words[k * slots + l] = k < SUMS ? 0 : k < LEAST ? NONE : -NONE;
            }
        }
        team.sync();
    }

    // Measures everything except the trimmed extremes, from the listed cells. Ends in a sync.
    void measure(
        const Team& team, int count, const CellList& listed, int wide, const int* x, const int* z,
        const int* height
    ) const {
        clear(team, count);
        const int all = *listed.count;
#if defined(__CUDA_ARCH__)
        const Warp warp(team);
        for (int first = warp.index * Warp::size; first < all; first += warp.count * Warp::size) {
            const int i = first + warp.lane < all ? first + warp.lane : all - 1;
            const int label = listed.label[i], k = listed.cell[i], r = listed.right[i];
            const int f = listed.forward[i], h = height[k], x_here = x[k], z_here = z[k];
            const int row = k / wide, column = k % wide;
            // Labels are processed one after the other; lane n updates field n.
            for (unsigned rest = warp.ballot(first + warp.lane < all); rest;) {
                const int l = warp.broadcast(label, BitRows::lowest(rest));
                const bool own = label == l && first + warp.lane < all;
                const unsigned those = warp.ballot(own);
                rest &= ~those;
                const auto least = [&](int value) { return warp.min(own ? value : (int)NONE); };
                const auto most = [&](int value) { return warp.max(own ? value : -(int)NONE); };
                const int found[UNTRIMMED] = {
                    BitRows::popcount(those),
                    least(k), least(row), least(column), least(r), least(f), least(h),
                    least(z_here), least(x_here), most(row), most(column), most(r), most(f), most(h),
                };
                int mine = 0;
                for (int n = 0; n < UNTRIMMED; ++n) mine = warp.lane == n ? found[n] : mine;
                add(team, l, warp.lane, mine);
            }
        }
#else
        for (int i = 0; i < all;) {
            const int l = listed.label[i], from = listed.cell[i], row = from / wide;
            const int end = (row + 1) * wide - from, left = all - i < end ? all - i : end;
            const int *own = listed.label + i, *cell = listed.cell + i, *at = z + from;
            const int *right = listed.right + i, *forward = listed.forward + i;
            const int *high = height + from, *across = x + from;
            int n = 0;
            Extremes r, f, h, d, w;
            // A run of adjacent cells of one row and label.
            for (; n < left && own[n] == l && cell[n] == from + n; ++n) {
                r.add(right[n]), f.add(forward[n]), h.add(high[n]), d.add(at[n]), w.add(across[n]);
            }
            const int column = from - row * wide;
            const int found[UNTRIMMED] = {n, from, row, column, r.low, f.low, h.low, d.low,
                                      w.low, row, column + n - 1, r.high, f.high, h.high};
            for (int k = 0; k < UNTRIMMED; ++k) add(team, l, k, found[k]);
            i += n;
        }
#endif
        team.sync();
    }

    // Updates field k of a label by the value of this field for some of the label's cells.
    void add(const Team& team, int l, int k, int value) const {
        int* place = words + k * slots + l;
        if (k < SUMS) team.atomic_add(place, value);
        else if (k < LEAST) team.atomic_min(place, value);
        else if (k < UNTRIMMED) team.atomic_max(place, value);
    }

    // Merges the extents of parts: part `l` belongs to label `whole[l]`. Ends in a sync.
    void join(const Team& team, int count, const Extents& parts, int of, const int* whole) const {
        clear(team, count);
        for (int l = team.rank; l < of; l += team.size) {
            for (int k = 0; k < UNTRIMMED; ++k)
                add(team, whole[l], k, parts.words[k * parts.slots + l]);
        }
        team.sync();
    }
};

// Trimmed extremes: the k-th smallest and k-th largest value of each label, by a counting sort by label
// and order statistics.
struct Trimmed {
    int count, all;
    const int *label, *value;  // label and value of each listed cell
    // For each label: number of cells; extremes; and number of cells that are trimmed at each end. If
    // no cells are trimmed, the results are the extremes.
    const int *cells, *low, *high, *over;
    int *least, *most;  // results: trimmed extremes
    // Scratch: index of the first value of each label, then the number of values; index at which the
    // next value of each label is stored; and the values, sorted by label.
    int *start, *next, *sorted;

    // Computes the trimmed extremes of all labels. Ends in a sync.
    void run(const Team& team) const {
        const Warp warp(team);
        for (int l = team.rank; l < count; l += team.size) start[l] = over[l] ? cells[l] : 0;
        team.sync();
        if (warp.index == 0) {
            warp.exclusive_sum(start, count);
            for (int l = warp.lane; l < count; l += warp.size) next[l] = start[l];
        }
        team.sync();
        for (int i = team.rank; i < all; i += team.size)
            if (over[label[i]]) sorted[team.atomic_count(next + label[i])] = value[i];
        team.sync();
        const Ranks ranks(warp);
        for (int i = warp.index; i < 2 * count; i += warp.count) {
            const int l = i >> 1, flip = -(i & 1);
            const int first = flip ? ~high[l] : low[l], last = flip ? ~low[l] : high[l];
            const int found = over[l]
                ? ranks.at(sorted, flip, start[l], start[l + 1], over[l], first, last) : first;
            if (warp.lane == 0) (flip ? most : least)[l] = found ^ flip;
        }
        team.sync();
    }
};

} }  // namespace jaxdet
