// Group of threads of a team that share a task: the complete team, or a warp. On the CPU it is a single
// thread.
#pragma once
#include "warp.h"

namespace jaxdet { namespace {

struct ThreadGroup {
    enum { WARP = Warp::size, MOST_SUMS = 10, MOST_SHARED = 4 };
    const Team* team;
    // For a complete team: two rows of the warps' sums, used alternately. Null if the group is a warp.
    unsigned long long* rows;
    int turn;

    // Groups of one warp each.
    explicit ThreadGroup(const Team& all) : team(&all), rows(nullptr), turn(0) {}

    // A group of the complete team; `scratch` has words(team) words.
    ThreadGroup(const Team& all, unsigned long long* scratch) : team(&all), rows(scratch), turn(0) {}

    static int words(const Team& all) {
        return 2 * 2 * MOST_SUMS * ((all.size + WARP - 1) / WARP) + MOST_SHARED;
    }

    // index, count  index of this group in the team, and number of groups
    // leads         whether this thread is in the first warp, which does work for the complete team that
    //               would be the same in all warps
    // broadcast     sends results of the first warp to the other threads, at most MOST_SHARED values;
    //               between any two calls there must be a sum
    // sum           replaces each of at most MOST_SUMS values by its sum over the group; a collective call
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
    // A thread that fills a row has passed the sync of the previous sum, which all readers of that row
    // reached after reading it.
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
