// How surfaces face each other along lines. Twin of `facing` in jaxdet/reference/_evidence.py.
#pragma once
#include "team.h"

// What a cell is, in one word.
struct Packed {
    enum { DEPTH_BITS = 20, FREE = 1 << DEPTH_BITS, LABEL_SHIFT = DEPTH_BITS + 1 };

    int word;

    explicit Packed(int word) : word(word) {}
    Packed(int label, int free, int z)
        : word((label + 1) << LABEL_SHIFT | (free != 0) << DEPTH_BITS | z) {}

    int label() const { return (word >> LABEL_SHIFT) - 1; }
    int free() const { return word >> DEPTH_BITS & 1; }
    int z() const { return word & (FREE - 1); }
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
    enum { MOST_BETWEEN = 11, RING = 16, SLOPE = 10, AHEAD = 8, FAR = 1 << 30 };
    // A run of cells of one label in a line. `before` and `after` are the free cells of the line
    // up to its first cell and up to behind its last.
    struct Run {
        int label, first, last, before, after, z_first, z_last, nearest, farthest;
        bool repeated;
    };
    // Lines of packed cells: `stride` from one to the next, `step` from cell to cell.
    const int* cells;
    int lines, length, stride, step;
    const int* along;  // place along the line, of each cell of the frame
    int along_stride, along_step;
    bool in_rows;
    int gap;
    const unsigned char* near;  // of each pair: whether it matters
    Sum* sums;                  // of each pair SUMS, zero before

    void run(const Team& team) const {
        for (int line = team.rank; line < lines; line += team.size) {
            walk(team, cells + line * stride, along + line * along_stride);
        }
    }

#if defined(__CUDA_ARCH__)
    // AHEAD cells at a time: their loads wait together.
    void walk(const Team& team, const int* cell, const int* place) const {
        Run ring[RING];
        int runs = 0, frees = 0, label = -1, first = 0, before = 0;
        int z_first = 0, z = 0, nearest = 0, farthest = 0;
        for (int start = 0; start <= length; start += AHEAD) {
            int ahead[AHEAD], between = label, free = 0;
            for (int n = 0; n < AHEAD; ++n)
                ahead[n] = start + n < length ? cell[(start + n) * step] : 0;
            for (int n = 0; n < AHEAD; ++n) {
                between &= Packed(ahead[n]).label();
                free += Packed(ahead[n]).free();
            }
            // Mostly there is no surface.
            if (between == -1) {
                frees += free;
                continue;
            }
            for (int n = 0; n < AHEAD && start + n <= length; ++n) {
                const Packed at(ahead[n]);
                const int k = start + n;
                if (at.label() != label) {
                    if (label >= 0) {
                        ring[runs % RING] = {label, first, k - 1, before, frees, z_first, z, nearest,
                                             farthest, false};
                        meet(team, ring, runs++, place);
                    }
                    label = at.label();
                    first = k;
                    before = frees;
                    z_first = nearest = farthest = at.z();
                }
                z = at.z();
                nearest = z < nearest ? z : nearest;
                farthest = z > farthest ? z : farthest;
                frees += at.free();
            }
        }
    }
#else
    void walk(const Team& team, const int* cell, const int* place) const {
        Run ring[RING];
        int runs = 0, frees = 0;
        for (int k = 0; k < length;) {
            Packed at(cell[k * step]);
            const int label = at.label();
            if (label < 0) {
                frees += at.free();
                ++k;
                continue;
            }
            Run& run = ring[runs % RING];
            run.label = label;
            run.first = k;
            run.before = frees;
            int z = at.z(), nearest = z, farthest = z;
            run.z_first = z;
            for (;;) {
                frees += at.free();
                if (++k == length) break;
                at = Packed(cell[k * step]);
                if (at.label() != label) break;
                z = at.z();
                nearest = z < nearest ? z : nearest;
                farthest = z > farthest ? z : farthest;
            }
            run.last = k - 1;
            run.after = frees;
            run.z_last = z;
            run.nearest = nearest;
            run.farthest = farthest;
            run.repeated = false;
            meet(team, ring, runs++, place);
        }
    }
#endif

    // A new run and those before it, of which neither's label may lie between.
    void meet(const Team& team, Run* ring, int index, const int* place) const {
        const Run& right = ring[index % RING];
        int nearest = FAR, farthest = -1;
        for (int away = 1; away <= MOST_BETWEEN + 1 && away <= index; ++away) {
            Run& left = ring[(index - away) % RING];
            if (left.label == right.label) {
                left.repeated = true;
                break;
            }
            if (!left.repeated) count(team, left, right, nearest, farthest, place);
            nearest = left.nearest < nearest ? left.nearest : nearest;
            farthest = left.farthest > farthest ? left.farthest : farthest;
        }
    }

    void count(
        const Team& team, const Run& left, const Run& right, int nearest, int farthest,
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
            team.add(own + COLUMNS, seen | (Sum)(hidden || hole) << 2 * COUNT_BITS);
            return;
        }
        team.add(own + ROWS, seen | (Sum)hidden << 2 * COUNT_BITS);
        if (through) return;
        const int apart = place[right.first * along_step] - place[left.last * along_step];
        const int slope = (apart < 0 ? -apart : apart) / SLOPE;
        const bool agree = (hidden || hole) && high - low <= gap + slope;
        team.add(own + STEPS, (Sum)agree | (Sum)(high - low) << STEP_SHIFT);
    }
};
