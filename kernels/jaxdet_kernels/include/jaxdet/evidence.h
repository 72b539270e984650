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
    // Number of pairs whose evidence a block computes together; the number of its threads is a
    // multiple.
    enum { BATCH = 64, FAST = (FEATURES + 1) * BATCH, NOT_NEAR = 1 << 30 };
    int count, lateral_gap, forward_gap, gap, no_step;
    Extents extents;
    Contours contours;
    Trees trees;
    unsigned char* near;  // scratch, (pairs): whether a pair is near enough to be evaluated
    Sum* sums;            // scratch, (pairs, Facing::SUMS): statistics of facing cells
    int *list, *listed;   // scratch: nearby pairs, and their number
    int* between;         // result, (count, count): evidence between surfaces
    // FAST words of shared memory on CUDA.
    int* fast;

    int least(int a, int b) const { return a < b ? a : b; }
    int most(int a, int b) const { return a > b ? a : b; }

    // Lists the pairs whose distance on the floor is within the gaps, and clears their sums. Ends in a
    // sync.
    void find_near(const Team& team) const {
        if (team.rank == 0) *listed = 0;
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
#if defined(__CUDA_ARCH__)
        // Compute the features of BATCH pairs at a time; then the threads share the trees of each pair.
        int *features = fast, *weights = features + FEATURES * BATCH;
        const int own = team.rank % BATCH, share = team.rank / BATCH, shares = team.size / BATCH;
        for (int first = 0; first < *listed; first += BATCH) {
            const bool some = first + own < *listed;
            const int pair = some ? list[first + own] : 0, a = pair >> 16, b = pair & 0xffff;
            if (share == 0) {
                const bool near = some && write_features(a, b, features + own, BATCH);
                weights[own] = near ? trees.offset : NOT_NEAR;
            }
            team.sync();
            const bool weighs = weights[own] != NOT_NEAR;
            team.sync();
            if (weighs) {
                int sum = 0;
                trees.weigh(features + own, BATCH, share, shares, &sum);
                team.atomic_add(weights + own, sum);
            }
            team.sync();
            if (share == 0 && some) {
                between[a * count + b] = between[b * count + a] = weighs ? weights[own] : 0;
            }
        }
#else
        enum { ABREAST = Trees::ABREAST };
        int features[FEATURES * ABREAST] = {}, some[ABREAST], n = 0;
        for (int item = 0; item < *listed; ++item) {
            some[n] = list[item];
            n += write_features(some[n] >> 16, some[n] & 0xffff, features + n, ABREAST);
            if (n < ABREAST && item + 1 < *listed) continue;
            int sums[ABREAST] = {};
            trees.weigh(features, ABREAST, 0, 1, sums);
            for (int k = 0; k < n; ++k) {
                const int a = some[k] >> 16, b = some[k] & 0xffff;
                between[a * count + b] = between[b * count + a] = trees.offset + sums[k];
            }
            n = 0;
        }
#endif
        team.sync();
    }

    long long squared(long long a, long long b) const { return a * a + b * b; }

    bool facing(const Sum* own) const { return own[Facing::ROWS] || own[Facing::COLUMNS]; }

    // Finds the smallest distance between the contours of two surfaces that face each other or are
    // close.
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

    // Whether surface a counts as the smaller one of the two.
    bool fewer(int a, int b) const {
        const int one[] = {extents.cells[a], extents.width(a), extents.depth(a), extents.bottom[a]};
        const int other[] = {extents.cells[b], extents.width(b), extents.depth(b), extents.bottom[b]};
        for (int k = 0; k < 4; ++k) {
            if (one[k] != other[k]) return one[k] < other[k];
        }
        return extents.top[a] != extents.top[b] ? extents.top[a] < extents.top[b] : a < b;
    }

    // Writes the features of a pair of surfaces to every `stride`-th word; returns false if the surfaces
    // are not close.
    bool write_features(int a, int b, int* features, int stride) const {
        const Sum* own = sums + (size_t)Pair(a, b).place * Facing::SUMS;
        if (own[Facing::DISTANCE] == ~0ull) return false;
        const int distance = SquareRoot::of(own[Facing::DISTANCE]);
        if (!facing(own) && distance > CONTACT * gap) return false;
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
        for (int k = 0; k < FEATURES; ++k) features[k * stride] = all[k];
        return true;
    }
};

} }  // namespace jaxdet
