// Correlation clustering by greedy additive edge contraction.
// Twin of `contracted` in jaxdet/reference/_obstacles.py.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct Contraction {
    typedef unsigned long long Key;
    enum { NODE_BITS = 10, NODE = (1 << NODE_BITS) - 1, TURNS = 3 };
    int count;
    int* between;    // (count, count) weights, symmetric, 0 on the diagonal; modified
    Key* best;       // scratch, (count): best key of each node's edges
    Key* turns;      // scratch, (2 * TURNS): best keys, see `run`
    int* group;      // result, (count): the smallest node of each node's group

    // Key of an edge. The smallest key is best: the largest weight, then the first pair of nodes.
    Key key(int weight, int one, int other) const {
        if (weight <= 0) return ~0ull;
        return ((Key)(0x7fffffff - weight) << NODE_BITS | one) << NODE_BITS | other;
    }

    // Best key of the edges between a node and later nodes.
    Key best_of(int one) const {
        int largest = 0, with = 0;
        for (int other = one + 1; other < count; ++other) {
            const int weight = between[one * count + other];
            if (weight > largest) largest = weight, with = other;
        }
        return key(largest, one, with);
    }

    // Runs the contraction. Each turn merges two nodes and computes the best key of the next turn. `turns`
    // has two ring buffers of TURNS keys, indexed by turn: the best key of all nodes, and the best key of
    // the node that grew in the turn before. Ends in a sync.
    void run(const Team& team) const {
        if (team.rank == 0) {
            for (int k = 0; k < 2 * TURNS; ++k) turns[k] = ~0ull;
        }
        team.sync();
        for (int node = team.rank; node < count; node += team.size) {
            group[node] = node;
            best[node] = best_of(node);
            team.atomic_min(turns, best[node]);
        }
        team.sync();
        int grown = -1;
        for (int turn = 0; turns[turn] != ~0ull;) {
            const Key chosen = turns[turn];
            const int kept = (int)(chosen >> NODE_BITS & NODE), gone = (int)(chosen & NODE);
            const int next = (turn + 1) % TURNS, after = (turn + 2) % TURNS;
            if (team.rank == 0) turns[after] = turns[TURNS + after] = ~0ull;
            for (int node = team.rank; node < count; node += team.size) {
                if (node == grown) best[node] = turns[TURNS + turn];
                if (group[node] == gone) group[node] = kept, best[node] = ~0ull;
                if (group[node] != node) continue;
                if (node == kept) {
                    between[kept * count + gone] = between[gone * count + kept] = 0;
                    continue;
                }
                int* own = between + node * count;
                const int moved = own[gone], sum = own[kept] + moved;
                if (moved) {
                    own[kept] = between[kept * count + node] = sum;
                    own[gone] = between[gone * count + node] = 0;
                    const int with = (int)(best[node] & NODE);
                    if (best[node] != ~0ull && (with == gone || with == kept)) {
                        best[node] = best_of(node);
                    } else if (kept > node && key(sum, node, kept) < best[node]) {
                        best[node] = key(sum, node, kept);
                    }
                }
                if (node > kept) {
                    team.atomic_min(turns + next, key(sum, kept, node));
                    team.atomic_min(turns + TURNS + next, key(sum, kept, node));
                }
                team.atomic_min(turns + next, best[node]);
            }
            grown = kept;
            turn = next;
            team.sync();
        }
        team.sync();
    }
};

} }  // namespace jaxdet
