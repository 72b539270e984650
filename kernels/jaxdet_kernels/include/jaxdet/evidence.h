// What is seen of each two surfaces that may be one thing, and how much it speaks for that.
// Twin of `pairs` in jaxdet/reference/_evidence.py and of `evidence` in jaxdet/affinity.py.
#pragma once
#include "contours.h"
#include "extents.h"
#include "facing.h"
#include "square_root.h"

namespace jaxdet { namespace {

// Boosted regression trees, each complete: node k has the children 2 k + 1 (at most the threshold)
// and 2 k + 2.
struct Trees {
    const int *feature, *threshold, *value;
    int trees, leaves, offset;

    // Where tree after tree leads, from `first` on, each by `step` later. What is seen lies `apart`.
    int weigh(const int* seen, int apart, int first, int step) const {
        int sum = 0;
        for (int tree = first; tree < trees; tree += step) {
            const int *which = feature + tree * (leaves - 1), *most = threshold + tree * (leaves - 1);
            int node = 0;
            while (node < leaves - 1) node = 2 * node + 1 + (seen[which[node] * apart] > most[node]);
            sum += value[tree * leaves + node - (leaves - 1)];
        }
        return sum;
    }
};

struct Evidence {
    typedef unsigned long long Sum;
    // Threads that share the search for the smallest distance of two contours.
    enum { PARTS = Warp::size > 1 ? 8 : 1 };
    enum { CONTACT = 2, PERCENT = 100, SEEN = 26 };
    // Pairs that a block of BATCH threads or a multiple of it weighs at a time.
    enum { BATCH = 64, FAST = (SEEN + 1) * BATCH, NOT_NEAR = 1 << 30 };
    int count, lateral_gap, forward_gap, gap, no_step;
    Extents known;
    Contours contours;
    Trees trees;
    unsigned char* near;  // scratch, of each pair
    Sum* sums;            // scratch, Facing::SUMS of each pair
    int *list, *listed;   // scratch: the pairs that are near, and how many
    int* between;         // result, (count, count)
    // On CUDA, FAST words of fast memory.
    int* fast;

    int least(int a, int b) const { return a < b ? a : b; }
    int most(int a, int b) const { return a > b ? a : b; }

    // The pairs within the gaps on the floor, with sums of 0. Ends in a sync.
    void find_near(const Team& team) const {
        if (team.rank == 0) *listed = 0;
        team.sync();
        for (int b = 0; b < count; ++b) {
            if (b % team.size == team.rank) between[b * count + b] = 0;
            for (int a = team.rank; a < b; a += team.size) {
                const int aside = most(known.left[a], known.left[b]) -
                                  least(known.right[a], known.right[b]);
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
        return most(most(known.near[a], known.near[b]) - least(known.far[a], known.far[b]), 0);
    }

    // Once the sums are complete. Ends in a sync.
    void run(const Team& team) const {
        for (int item = team.rank; item < *listed * PARTS; item += team.size) {
            measure(team, list[item / PARTS], item % PARTS);
        }
        team.sync();
#if defined(__CUDA_ARCH__)
        // What is seen of BATCH pairs at a time; then threads share the trees of a pair.
        int *seen = fast, *weights = seen + SEEN * BATCH;
        const int own = team.rank % BATCH, share = team.rank / BATCH, shares = team.size / BATCH;
        for (int first = 0; first < *listed; first += BATCH) {
            const bool some = first + own < *listed;
            const int pair = some ? list[first + own] : 0, a = pair >> 16, b = pair & 0xffff;
            if (share == 0) {
                weights[own] = some && look(a, b, seen + own, BATCH) ? trees.offset : NOT_NEAR;
            }
            team.sync();
            const bool weighs = weights[own] != NOT_NEAR;
            team.sync();
            if (weighs)
                team.atomic_add(weights + own, trees.weigh(seen + own, BATCH, share, shares));
            team.sync();
            if (share == 0 && some) {
                between[a * count + b] = between[b * count + a] = weighs ? weights[own] : 0;
            }
        }
#else
        for (int item = 0; item < *listed; ++item) {
            const int a = list[item] >> 16, b = list[item] & 0xffff;
            int seen[SEEN], weight = 0;
            if (look(a, b, seen, 1)) weight = trees.offset + trees.weigh(seen, 1, 0, 1);
            between[a * count + b] = between[b * count + a] = weight;
        }
#endif
        team.sync();
    }

    long long squared(long long a, long long b) const { return a * a + b * b; }

    bool facing(const Sum* own) const { return own[Facing::ROWS] || own[Facing::COLUMNS]; }

    // The smallest distance of the contours of two surfaces that face each other or are near.
    void measure(const Team& team, int pair, int part) const {
        int a = pair >> 16, b = pair & 0xffff;
        Sum* own = sums + (size_t)Pair(a, b).place * Facing::SUMS;
        if (!facing(own)) {
            const int x = most(known.right_low[a], known.right_low[b]) -
                          least(known.right_high[a], known.right_high[b]);
            const int y = most(known.forward_low[a], known.forward_low[b]) -
                          least(known.forward_high[a], known.forward_high[b]);
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

    // Whether one surface counts as the smaller one of two.
    bool fewer(int a, int b) const {
        const int one[] = {known.cells[a], known.width(a), known.depth(a), known.bottom[a]};
        const int other[] = {known.cells[b], known.width(b), known.depth(b), known.bottom[b]};
        for (int k = 0; k < 4; ++k) {
            if (one[k] != other[k]) return one[k] < other[k];
        }
        return known.top[a] != known.top[b] ? known.top[a] < known.top[b] : a < b;
    }

    // What is seen of two surfaces, each `apart` words from the last; false if they are not near.
    bool look(int a, int b, int* seen, int apart) const {
        const Sum* own = sums + (size_t)Pair(a, b).place * Facing::SUMS;
        if (own[Facing::DISTANCE] == ~0ull) return false;
        const int distance = SquareRoot::of(own[Facing::DISTANCE]);
        if (!facing(own) && distance > CONTACT * gap) return false;
        const Sum rows = own[Facing::ROWS], columns = own[Facing::COLUMNS];
        const Sum steps = own[Facing::STEPS] >> Facing::STEP_SHIFT;
        const int agree = (int)(own[Facing::STEPS] & ((1 << Facing::STEP_SHIFT) - 1));
        const int closed = part(rows, 0) - part(rows, 1);
        const int both = least(known.right[a], known.right[b]) -
                         most(known.left[a], known.left[b]);
        const int narrower = most(least(known.width(a), known.width(b)), 1);
        const int shorter = least(known.rows_of(a), known.rows_of(b));
        const int overlap = both >= 0 ? PERCENT * both / narrower
                                      : -((-PERCENT * both + narrower - 1) / narrower);
        const int less = fewer(a, b) ? a : b, more = a + b - less;
        const int all[SEEN] = {
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
            least(known.near[a], known.near[b]),
            known.cells[less],
            known.cells[more],
            known.width(less),
            known.width(more),
            known.depth(less),
            known.depth(more),
            known.bottom[less],
            known.bottom[more],
            known.top[less],
            known.top[more],
            known.near[less] - known.near[more],
            part(rows, 0),
            part(columns, 0),
            PERCENT * part(rows, 1) / most(part(rows, 0), 1),
            PERCENT * part(columns, 1) / most(part(columns, 0), 1),
        };
        for (int k = 0; k < SEEN; ++k) seen[k * apart] = all[k];
        return true;
    }
};

} }  // namespace jaxdet
