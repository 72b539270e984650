// How surfaces face each other along lines. Twin of `facing` in jaxdet/reference/_evidence.py.
#pragma once
#include "warp.h"

namespace jaxdet { namespace {

// The surface of a cell and its depth, in one word.
struct Packed {
    enum { DEPTH_BITS = 20 };
    int word;

    explicit Packed(int word) : word(word) {}
    Packed(int label, int z) : word(label << DEPTH_BITS | z) {}

    int label() const { return word >> DEPTH_BITS; }
    int z() const { return word & ((1 << DEPTH_BITS) - 1); }
};

// Two surfaces, and their place in lists of all pairs.
struct Pair {
    int low, high, place;

    Pair(int one, int other)
        : low(one < other ? one : other), high(one < other ? other : one),
          place(high * (high - 1) / 2 + low) {}
};

struct Facing {
    typedef unsigned long long Sum;
    // Sums of a pair: in rows, places, of these with free cells or something farther between,
    // and with something nearer, COUNT_BITS each; those that agree, and above STEP_SHIFT the steps;
    // in columns, places, of these as above, and with something nearer or a hole.
    enum { ROWS, STEPS, COLUMNS, DISTANCE, SUMS, COUNT_BITS = 21, STEP_SHIFT = 20 };
    enum { MOST_BETWEEN = 11, RING = 16, SLOPE = 10, FAR = 1 << 30 };
    // On CUDA the loads of so many cells wait together.
    enum { AHEAD = Warp::size > 1 ? 8 : 1 };
    // A run of cells of one label in a line. `before` and `after` are the free cells of the line
    // up to its first cell and up to behind its last.
    struct Run {
        int label, first, last, before, after, z_first, z_last, nearest, farthest;
    };
    // What later runs need of one; its label is -1 once there is another run of that label.
    struct Past {
        int label, last, after, z_last, nearest, farthest;
    };
    // Lines of cells: which have a surface and which are free; packed, those that have one, `stride`
    // from a line to the next, `step` from cell to cell; and their place along the line.
    BitRows has, free;
    const int *cells, *along;
    int stride, step;
    bool in_rows;
    int gap;
    const unsigned char* near;  // of each pair: whether it matters
    Sum* sums;                  // of each pair SUMS, zero before

    // All lines of two directions.
    static void run(const Team& team, const Facing& one, const Facing& other) {
        const int all = one.has.rows + other.has.rows;
        for (int i = team.rank; i < all; i += team.size) {
            const bool first = i < one.has.rows;
            const Facing& own = first ? one : other;
            const int line = first ? i : i - one.has.rows;
            own.walk(team, line, own.cells + line * own.stride, own.along + line * own.stride);
        }
    }

    void walk(const Team& team, int line, const int* cell, const int* place) const {
        Past ring[RING];  // the last runs of the line, a ring buffer
        Run run = {-1, 0, -2, 0, 0, 0, 0, 0, 0};
        int runs = 0, frees = 0;
        for (int i = has.at(line, 0); i < has.at(line + 1, 0); ++i) {
            const unsigned all = has[i], open = free[i];
            const auto frees_before = [&](unsigned bit) {
                return frees + BitRows::popcount(open & (bit - 1));
            };
            for (int start = 0; all >> start; start += AHEAD) {
                const unsigned some = all >> start & ((1 << AHEAD) - 1);
                const int first = has.column(i) + start;
                int word[AHEAD];
                for (int n = 0; n < AHEAD; ++n) word[n] = some >> n & 1 ? cell[(first + n) * step] : 0;
                for (int n = 0; n < AHEAD; ++n) {
                    if (!(some >> n & 1)) continue;
                    const Packed at(word[n]);
                    const int k = first + n, label = at.label(), z = at.z();
                    const unsigned bit = 1u << (start + n);
                    if (k != run.last + 1 || label != run.label) {
                        if (run.label >= 0) meet(team, ring, runs++, run, place);
                        run = {label, k, k, frees_before(bit), 0, z, z, z, z};
                    }
                    run.last = k;
                    run.after = frees_before(bit) + ((open & bit) != 0);
                    run.z_last = z;
                    run.nearest = z < run.nearest ? z : run.nearest;
                    run.farthest = z > run.farthest ? z : run.farthest;
                }
                if (start + AHEAD == BitRows::WIDTH) break;
            }
            frees += BitRows::popcount(open);
        }
        if (run.label >= 0) meet(team, ring, runs, run, place);
    }

    // A new run and those before it, of which neither's label may lie between; then it is one of
    // them.
    void meet(const Team& team, Past* ring, int index, const Run& right, const int* place) const {
        int nearest = FAR, farthest = -1;
        for (int away = 1; away <= MOST_BETWEEN + 1 && away <= index; ++away) {
            Past& left = ring[(index - away) % RING];
            if (left.label == right.label) {
                left.label = -1;
                break;
            }
            if (left.label >= 0) count(team, left, right, nearest, farthest, place);
            nearest = left.nearest < nearest ? left.nearest : nearest;
            farthest = left.farthest > farthest ? left.farthest : farthest;
        }
        ring[index % RING] = {right.label, right.last, right.after, right.z_last, right.nearest,
                              right.farthest};
    }

    void count(
        const Team& team, const Past& left, const Run& right, int nearest, int farthest,
        const int* place
    ) const {
        const int pair = Pair(left.label, right.label).place;
        if (!near[pair]) return;
        const int a = left.z_last, b = right.z_first, low = a < b ? a : b, high = a < b ? b : a;
        const bool through = right.before > left.after || farthest > high + gap;
        const bool hidden = !through && nearest < low - gap / 2;
        const bool hole = !through && !hidden && right.first > left.last + 1;
        const Sum seen = 1 | (Sum)through << COUNT_BITS;
        Sum* own = sums + (size_t)pair * SUMS;
        if (!in_rows) {
            team.atomic_add(own + COLUMNS, seen | (Sum)(hidden || hole) << 2 * COUNT_BITS);
            return;
        }
        team.atomic_add(own + ROWS, seen | (Sum)hidden << 2 * COUNT_BITS);
        if (through) return;
        const int apart = place[right.first * step] - place[left.last * step];
        const int slope = (apart < 0 ? -apart : apart) / SLOPE;
        const bool agree = (hidden || hole) && high - low <= gap + slope;
        team.atomic_add(own + STEPS, (Sum)agree | (Sum)(high - low) << STEP_SHIFT);
    }
};

} }  // namespace jaxdet
