// Connected components of the cells of a frame, made of runs: cells of a row that hang together.
#pragma once
#include "grid.h"
#include "team.h"

// Union-find over cells, by their index r C + c. A root is the smallest cell of its set; roots are
// joined by compare-and-swap, which only ever hangs a root below a smaller cell.
struct LinkedSets {
    int* parent;

    void start(int cell) const { parent[cell] = cell; }

    int find(int cell) const {
        volatile int* up = parent;
        int above = up[cell];
        while (above != cell) {
            const int next = up[above];
            up[cell] = next;
            cell = above;
            above = next;
        }
        return cell;
    }

    void link(const Team& team, int one, int two) const {
        while (true) {
            one = find(one);
            two = find(two);
            if (one == two) return;
            const int high = one > two ? one : two, low = one > two ? two : one;
            if (team.exchange(parent + high, high, low) == high) return;
        }
    }
};

// A row of bytes, whose bits say something of each cell; 7 more after it may be read.
struct Marks {
    const unsigned char* row;
    int n;

    // The first cell from c on that has this bit, n if none has. Eight are looked at at once.
    int next(int c, int bit) const {
        const unsigned long long each = 0x0101010101010101ull * (unsigned)bit;
        for (; c < n; c += 8) {
            unsigned long long eight = 0;
            for (int i = 0; i < 8; ++i) eight |= (unsigned long long)row[c + i] << (8 * i);
            eight &= each;
            if (!eight) continue;
#if defined(__CUDA_ARCH__)
            c += (__ffsll((long long)eight) - 1) / 8;
#else
            c += __builtin_ctzll(eight) / 8;
#endif
            return c < n ? c : n;
        }
        return n;
    }
};

// The runs of each row, from left to right, and the sets that they are linked to. A thread makes
// and links the runs of a row; threads may do so for all rows at once.
struct Runs {
    int rows, columns;
    // (R C): in each row its runs, `begin | end << 16`.
    int* runs;
    // (R): how many there are.
    int* counts;
    LinkedSets sets;
    // (R C): by the root, the cells of a set.
    int* sizes;

    int cell(int r, int c) const { return r * columns + c; }
    int count(int r) const { return counts[r]; }
    int begin(int r, int i) const { return runs[r * columns + i] & 0xffff; }
    int end(int r, int i) const { return runs[r * columns + i] >> 16; }
    int root(int r, int i) const { return sets.find(cell(r, begin(r, i))); }

    // The i-th run of a row.
    void put(int r, int i, int begin, int end) const {
        runs[r * columns + i] = begin | end << 16;
    }

    // Makes it a set of its own.
    void start(int r, int i) const {
        const int first = cell(r, begin(r, i));
        sets.start(first);
        sizes[first] = 0;
    }

    // Adds the cells of all runs to the sizes of their sets, which may be read after a sync.
    void measure(const Team& team) const {
        const Rows of(team);
        for (int r = of.first; r < rows; r += of.step)
            for (int i = of.lane; i < count(r); i += Rows::LANES)
                team.add(sizes + root(r, i), end(r, i) - begin(r, i));
    }

    // Links the runs of a row with those above it that share a column with them, or one more at
    // both sides (8-connected).
    void link_all(const Team& team, int r) const {
        for (int i = 0, j = 0; i < count(r) && j < count(r - 1);) {
            const int stop = end(r, i), above = end(r - 1, j);
            if (begin(r, i) <= above && begin(r - 1, j) <= stop)
                sets.link(team, cell(r, begin(r, i)), cell(r - 1, begin(r - 1, j)));
            stop < above ? ++i : ++j;
        }
    }

    // Links the runs of a row with those above it where a cell of theirs has the bit `up` set.
    void link_marked(const Team& team, int r, const unsigned char* marks, int up) const {
        for (int i = 0, j = 0; i < count(r) && j < count(r - 1);) {
            const int left = begin(r, i), over = begin(r - 1, j);
            const int stop = end(r, i), above = end(r - 1, j);
            const int until = stop < above ? stop : above;
            int c = left > over ? left : over;
            while (c < until && !(marks[c] & up)) ++c;
            if (c < until) sets.link(team, cell(r, left), cell(r - 1, over));
            stop < above ? ++i : ++j;
        }
    }
};
