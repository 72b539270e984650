// Threads of a team that work on one thing together: all of them, or a warp. On the CPU a group
// is the one thread there is.
#pragma once
#include "warp.h"

namespace jaxdet { namespace {

struct ThreadGroup {
    enum { WARP = Warp::size, MOST_SUMS = 10, MOST_SHARED = 4 };
    const Team* team;
    // Of a whole team: two rows of the warps' sums, used in turn. Null: the group is a warp.
    unsigned long long* rows;
    int turn;

    // A warp of a team.
    explicit ThreadGroup(const Team& all) : team(&all), rows(nullptr), turn(0) {}

    // A whole team; `scratch` has words(team) words.
    ThreadGroup(const Team& all, unsigned long long* scratch) : team(&all), rows(scratch), turn(0) {}

    static int words(const Team& all) {
        return 2 * 2 * MOST_SUMS * ((all.size + WARP - 1) / WARP) + MOST_SHARED;
    }

    // index, count  which of the groups of a team this is, and how many there are
    // leads         whether this thread is of the first warp, which works for a whole team where all
    //               would do the same
    // broadcast     what it then tells the others: at most MOST_SHARED values; a sum is between any two
    // sum           each of the values, at most MOST_SUMS, becomes its sum over the group; all must ask
    int rank() const { return rows ? team->rank : team->rank % WARP; }
    int size() const { return rows ? team->size : (int)WARP; }
    int index() const { return rows ? 0 : team->rank / WARP; }
    int count() const { return rows ? 1 : team->size / WARP; }
    bool leads() const { return rank() < WARP; }
#if defined(__CUDA_ARCH__)
    void broadcast(int* values, int n) const {
        if (!rows) return;
        volatile int* shared = (volatile int*)(rows + 2 * MOST_SUMS * (team->size / WARP));
        if (team->rank == 0)
            for (int k = 0; k < n; k++) shared[k] = values[k];
        team->sync();
        for (int k = 0; k < n; k++) values[k] = shared[k];
    }
    // Who fills a row passed the sync of the sum before, which all readers of that row reached
    // after they had read it.
    void sum(long long* values, int n) {
        const Warp warp(*team);
        for (int k = 0; k < n; k++) values[k] = warp.sum(values[k]);
        if (!rows) return;
        const int warps = team->size / WARP, lane = team->rank % WARP;
        unsigned long long* row = rows + turn * warps * MOST_SUMS;
        turn ^= 1;
        if (lane == 0)
            for (int k = 0; k < n; k++) row[team->rank / WARP * MOST_SUMS + k] = values[k];
        team->sync();
        long long total = 0;
        if (lane < n)
            for (int k = 0; k < warps; k++) total += row[k * MOST_SUMS + lane];
        for (int k = 0; k < n; k++) values[k] = __shfl_sync(0xffffffffu, total, k);
    }
#else
    void broadcast(int*, int) const {}
    void sum(long long*, int) {}
#endif
};

} }  // namespace jaxdet
