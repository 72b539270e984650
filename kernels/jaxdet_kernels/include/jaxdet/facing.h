// Statistics of pairs of surfaces that face each other along rows and columns. Twin of `facing` in
// jaxdet/reference/_evidence.py.
#pragma once
#include "warp.h"

namespace jaxdet { namespace {

// Label and depth of a cell, packed in one word.
struct Packed {
    enum { DEPTH_BITS = 20 };
    int word;

    explicit Packed(int word) : word(word) {}
    Packed(int label, int z) : word(label << DEPTH_BITS | z) {}

    int label() const { return word >> DEPTH_BITS; }
    int z() const { return word & ((1 << DEPTH_BITS) - 1); }
};

// Unordered pair of surfaces, and its index in lists of all pairs.
struct Pair {
    int low, high, place;

    Pair(int one, int other)
        : low(one < other ? one : other), high(one < other ? other : one),
          place(high * (high - 1) / 2 + low) {}
};

struct Facing {
    typedef unsigned long long Sum;
    // Indices of the sums of a pair. A place is where the two surfaces face each other in a row or a
    // column. ROWS packs three counts of places in rows, with COUNT_BITS bits each: all places; places
    // with free cells or something farther between the surfaces; places with something nearer between
    // them. STEPS packs the number of places in rows whose depths agree and, from bit STEP_SHIFT on, the
    // sum of depth steps. COLUMNS packs three counts of places in columns: all places; places with free
    // cells or something farther between; places with something nearer or a hole between. DISTANCE is
    // used by `Evidence`.
    enum { ROWS, STEPS, COLUMNS, DISTANCE, SUMS, COUNT_BITS = 21, STEP_SHIFT = 20 };
    enum { MOST_BETWEEN = 11, RING = 16, SLOPE = 10, FAR = 1 << 30 };
    // Run of cells with the same label in a line, i.e. a row or a column. `before` is the number of free
    // cells of the line before the first cell of the run; `after` includes those up to its last cell.
    struct Run {
        int label, first, last, before, after, z_first, z_last, nearest, farthest;
    };
    // Summary of an earlier run; its label becomes -1 once a later run has the same label.
    struct Past {
        int label, last, after, z_last, nearest, farthest;
    };
    // Bitmaps of the cells with a surface and of the free cells, with one row per line. `cells` holds
    // packed cells, which are valid only for cells with a surface; `along` holds their positions along
    // the line. Lines are `stride` elements apart, and the cells of a line are `step` elements apart.
    BitRows has, free;
    const int *cells, *along;
    int stride, step;
    bool in_rows;
    int gap;
    const unsigned char* near;  // whether each pair is evaluated
    Sum* sums;                  // (pairs, SUMS) statistics, initialised with 0

    // Processes the lines of both directions: `one` and `other` are those of rows and of columns.
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
        Past ring[RING];  // ring buffer of the last runs of the line
        Run run = {-1, 0, -2, 0, 0, 0, 0, 0, 0};
        int runs = 0, frees = 0;
        for (int i = has.at(line, 0); i < has.at(line + 1, 0); ++i) {
            const unsigned open = free[i];
            const auto frees_before = [&](unsigned bit) {
                return frees + BitRows::popcount(open & (bit - 1));
            };
            for (unsigned rest = has[i]; rest; rest &= rest - 1) {
                const int bit_of = BitRows::lowest(rest), k = has.column(i) + bit_of;
                const Packed at(cell[k * step]);
                const int label = at.label(), z = at.z();
                const unsigned bit = 1u << bit_of;
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
            frees += BitRows::popcount(open);
        }
        if (run.label >= 0) meet(team, ring, runs, run, place);
    }

    // Updates the sums of the pairs of a new run and earlier runs, if neither label occurs between the
    // two runs; then adds the new run to the ring.
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
