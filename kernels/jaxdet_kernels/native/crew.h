// Threads of a team that work on one thing together: all of them, or a warp of 32. On the CPU a
// crew is the one thread there is.
#pragma once
#include "team.h"

struct Crew {
    enum { WARP = 32, MOST_SUMS = 10, WORDS = 2 * 3 * MOST_SUMS };
    const Team* team;
    // Of a whole team: three rows of sums, used in turn. Null: the crew is a warp.
    unsigned long long* rows;
    int turn;

    // A warp of a team.
    explicit Crew(const Team& all) : team(&all), rows(nullptr), turn(0) {}

    // A whole team; `scratch` has WORDS words. To be built by all threads.
    Crew(const Team& all, unsigned long long* scratch) : team(&all), rows(scratch), turn(0) {
        for (int k = all.rank; k < 3 * MOST_SUMS; k += all.size) rows[k] = 0;
        all.sync();
    }

#if defined(__CUDA_ARCH__)
    int rank() const { return rows ? team->rank : team->rank % WARP; }
    int size() const { return rows ? team->size : WARP; }
    // Which of the crews of a team this is, and how many there are.
    int index() const { return rows ? 0 : team->rank / WARP; }
    int count() const { return rows ? 1 : team->size / WARP; }
#else
    int rank() const { return 0; }
    int size() const { return 1; }
    int index() const { return 0; }
    int count() const { return 1; }
#endif

    // Each of the values, at most MOST_SUMS, becomes its sum over the crew; all must ask.
    //
    // A row is filled while the one after it is emptied. The thread that is emptying a row passed
    // the sync of the sum before, which all readers of that row reached after they had read it.
    void sum(long long* values, int n) {
#if defined(__CUDA_ARCH__)
        for (int k = 0; k < n; k++)
            for (int half = WARP / 2; half; half /= 2)
                values[k] += __shfl_xor_sync(0xffffffffu, values[k], half);
        if (!rows) return;
        unsigned long long* row = rows + turn * MOST_SUMS;
        turn = turn == 2 ? 0 : turn + 1;
        if (team->rank < MOST_SUMS) rows[turn * MOST_SUMS + team->rank] = 0;
        if (team->rank % WARP == 0)
            for (int k = 0; k < n; k++) team->add(row + k, (unsigned long long)values[k]);
        team->sync();
        for (int k = 0; k < n; k++) values[k] = (long long)((volatile unsigned long long*)row)[k];
#else
        (void)values;
        (void)n;
#endif
    }
};
