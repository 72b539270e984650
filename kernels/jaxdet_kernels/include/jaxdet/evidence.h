// Features of pairs of surfaces that may belong to the same object, and the resulting evidence. Twin of
// `pairs` in jaxdet/reference/_evidence.py and of `evidence` in jaxdet/affinity.py.
#pragma once
#include "contours.h"
#include "extents.h"
#include "facing.h"
#include "square_root.h"

namespace jaxdet { namespace {

// Ensemble of boosted regression trees; each is a complete binary tree. Node k has the children 2 k + 1,
// for features up to the threshold, and 2 k + 2, for larger ones.
struct Trees {
    // Number of pairs that the CPU weighs together, so that the latencies of their loads overlap.
    enum { ABREAST = Warp::size > 1 ? 1 : 16 };
    const int *feature, *threshold, *value;
    int trees, leaves, offset;

    // Adds the values of the trees `first`, `first + step`, ... to the sums of ABREAST pairs. The features
    // of a pair are `stride` words apart; the same feature of the next pair is in the next word.
    void weigh(const int* features, int stride, int first, int step, int* sums) const {
        for (int tree = first; tree < trees; tree += step) {
            const int *which = feature + tree * (leaves - 1), *most = threshold + tree * (leaves - 1);
            int node[ABREAST] = {};
            for (int wide = 1; wide < leaves; wide *= 2)
                for (int k = 0; k < ABREAST; ++k) {
                    const int at = node[k];
                    node[k] = 2 * at + 1 + (features[which[at] * stride + k] > most[at]);
                }
            for (int k = 0; k < ABREAST; ++k) sums[k] += value[tree * leaves + node[k] - (leaves - 1)];
        }
    }
};

struct Evidence {
    typedef unsigned long long Sum;
    // Number of threads that share the search for the smallest distance between two contours.
    enum { PARTS = Warp::size > 1 ? 8 : 1 };
    enum { CONTACT = 2, PERCENT = 100, FEATURES = 26 };
    // Number of pairs whose evidence a team computes together; on CUDA the number of threads of a team
    // is a multiple of it.
    enum { ABREAST = Trees::ABREAST, BATCH = Warp::size > 1 ? 64 : (int)ABREAST };
    enum { FAST = FEATURES * BATCH };
    int count, lateral_gap, forward_gap, gap, no_step;
    Extents extents;
    Contours contours;
    Trees trees;
    unsigned char* near;  // scratch, (pairs): whether a pair is near enough to be evaluated
    Sum* sums;            // scratch, (pairs, Facing::SUMS): statistics of facing cells
    int *list, *listed;   // scratch: nearby pairs, and their number
    int *close, *num_close;  // scratch: nearby pairs that face each other or are close, and their number
    int* between;         // result, (count, count): evidence between surfaces
    int* fast;            // FAST words of fast memory: the features of a batch

    int least(int a, int b) const { return a < b ? a : b; }
    int most(int a, int b) const { return a > b ? a : b; }

    // Lists the pairs whose distance on the floor is within the gaps, and clears their sums. Ends in a
    // sync.
    void find_near(const Team& team) const {
        if (team.rank == 0) *listed = *num_close = 0;
        team.sync();
        for (int b = 0; b < count; ++b) {
            if (b % team.size == team.rank) between[b * count + b] = 0;
            for (int a = team.rank; a < b; a += team.size) {
                const int aside = most(extents.left[a], extents.left[b]) -
                                  least(extents.right[a], extents.right[b]);
                const int ahead = ahead_of(a, b), pair = Pair(a, b).place;
                between[a * count + b] = between[b * count + a] = 0;
                near[pair] = most(aside, 0) <= lateral_gap && ahead <= forward_gap;
                if (!near[pair]) continue;
                list[team.atomic_add(listed, 1)] = a << 16 | b;
                Sum* own = sums + (size_t)pair * Facing::SUMS;
                own[Facing::ROWS] = own[Facing::STEPS] = own[Facing::COLUMNS] = 0;
                own[Facing::DISTANCE] = ~0ull;
            }
        }
        team.sync();
    }

    int ahead_of(int a, int b) const {
        return most(most(extents.near[a], extents.near[b]) - least(extents.far[a], extents.far[b]), 0);
    }

    // Computes the evidence of the listed pairs; the sums of `Facing` must be complete. Ends in a sync.
    void run(const Team& team) const {
        for (int item = team.rank; item < *listed * PARTS; item += team.size) {
            measure(team, list[item / PARTS], item % PARTS);
        }
        team.sync();
        for (int item = team.rank; item < *listed; item += team.size)
            if (is_close(list[item])) close[team.atomic_add(num_close, 1)] = list[item];
        team.sync();
        // The features of BATCH pairs are computed at a time. Then each thread adds the values of its
        // share of the trees for ABREAST pairs of the batch, from pair `own` on.
        const int own = team.rank * ABREAST % BATCH, share = team.rank * ABREAST / BATCH;
        const int shares = team.size * ABREAST / BATCH, all = *num_close;
        for (int first = 0; first < all; first += BATCH) {
            for (int k = own; share == 0 && k < own + ABREAST; ++k)
                write_features(close[least(first + k, all - 1)], fast + k);
            team.sync();
            int sums[ABREAST] = {};
            trees.weigh(fast + own, BATCH, share, shares, sums);
            for (int k = 0; k < ABREAST && first + own + k < all; ++k) {
                const int pair = close[first + own + k], a = pair >> 16, b = pair & 0xffff;
                const int sum = sums[k] + (share ? 0 : trees.offset);
                team.atomic_add(between + a * count + b, sum);
                team.atomic_add(between + b * count + a, sum);
            }
            team.sync();
        }
    }

    long long squared(long long a, long long b) const { return a * a + b * b; }

    bool facing(const Sum* own) const { return own[Facing::ROWS] || own[Facing::COLUMNS]; }

    // Finds the smallest distance between the contours of two surfaces that face each other or are
    // close, from every PARTS-th point of the shorter contour, beginning with point `part`.
    void measure(const Team& team, int pair, int part) const {
        int a = pair >> 16, b = pair & 0xffff;
        Sum* own = sums + (size_t)Pair(a, b).place * Facing::SUMS;
        if (!facing(own)) {
            const int x = most(extents.right_low[a], extents.right_low[b]) -
                          least(extents.right_high[a], extents.right_high[b]);
            const int y = most(extents.forward_low[a], extents.forward_low[b]) -
                          least(extents.forward_high[a], extents.forward_high[b]);
            if (squared(most(x, 0), most(y, 0)) > squared(CONTACT * gap + 1, 0)) return;
        }
        const int* start = contours.start;
        if (start[a + 1] - start[a] > start[b + 1] - start[b]) {
            const int swapped = a;
            a = b, b = swapped;
        }
        const int points = start[b + 1] - start[b];
        const int *x = contours.x + start[b], *y = contours.y + start[b];
        long long best = ~0ull >> 1;
        for (int i = start[a] + part; i < start[a + 1]; i += PARTS) {
            const int ax = contours.x[i], ay = contours.y[i];
            for (int k = 0; k < points; ++k) {
                const long long apart = squared(x[k] - ax, y[k] - ay);
                best = apart < best ? apart : best;
            }
        }
        team.atomic_min(own + Facing::DISTANCE, (Sum)best);
    }

    int part(Sum sum, int k) const {
        return (int)(sum >> k * Facing::COUNT_BITS & ((1 << Facing::COUNT_BITS) - 1));
    }

    // Whether surface a counts as smaller than b: it has fewer cells or, if as many, a smaller extent.
    bool fewer(int a, int b) const {
        const int one[] = {extents.cells[a], extents.width(a), extents.depth(a), extents.bottom[a]};
        const int other[] = {extents.cells[b], extents.width(b), extents.depth(b), extents.bottom[b]};
        for (int k = 0; k < 4; ++k) {
            if (one[k] != other[k]) return one[k] < other[k];
        }
        return extents.top[a] != extents.top[b] ? extents.top[a] < extents.top[b] : a < b;
    }

    const Sum* sums_of(int pair) const {
        return sums + (size_t)Pair(pair >> 16, pair & 0xffff).place * Facing::SUMS;
    }

    // Whether two surfaces face each other or their contours are close.
    bool is_close(int pair) const {
        const Sum* own = sums_of(pair);
        if (own[Facing::DISTANCE] == ~0ull) return false;
        return facing(own) || SquareRoot::of(own[Facing::DISTANCE]) <= CONTACT * gap;
    }

    // Writes the features of a pair of surfaces to every BATCH-th word.
    void write_features(int pair, int* features) const {
        const int a = pair >> 16, b = pair & 0xffff;
        const Sum* own = sums_of(pair);
        const int distance = SquareRoot::of(own[Facing::DISTANCE]);
        const Sum rows = own[Facing::ROWS], columns = own[Facing::COLUMNS];
        const Sum steps = own[Facing::STEPS] >> Facing::STEP_SHIFT;
        const int agree = (int)(own[Facing::STEPS] & ((1 << Facing::STEP_SHIFT) - 1));
        const int closed = part(rows, 0) - part(rows, 1);
        const int both = least(extents.right[a], extents.right[b]) -
                         most(extents.left[a], extents.left[b]);
        const int narrower = most(least(extents.width(a), extents.width(b)), 1);
        const int shorter = least(extents.rows_of(a), extents.rows_of(b));
        const int overlap = both >= 0 ? PERCENT * both / narrower
                                      : -((-PERCENT * both + narrower - 1) / narrower);
        const int less = fewer(a, b) ? a : b, more = a + b - less;
        const int all[FEATURES] = {
            distance,
            ahead_of(a, b),
            overlap,
            closed > 0 ? (int)(steps / closed) : no_step,
            part(rows, 1),
            PERCENT * part(rows, 2) / shorter,
            agree,
            PERCENT * agree / shorter,
            part(columns, 1),
            part(columns, 2),
            least(extents.near[a], extents.near[b]),
            extents.cells[less],
            extents.cells[more],
            extents.width(less),
            extents.width(more),
            extents.depth(less),
            extents.depth(more),
            extents.bottom[less],
            extents.bottom[more],
            extents.top[less],
            extents.top[more],
            extents.near[less] - extents.near[more],
            part(rows, 0),
            part(columns, 0),
            PERCENT * part(rows, 1) / most(part(rows, 0), 1),
            PERCENT * part(columns, 1) / most(part(columns, 0), 1),
        };
        for (int k = 0; k < FEATURES; ++k) features[k * BATCH] = all[k];
    }
};

} }  // namespace jaxdet
