// The cells of a frame sorted by obstacle.
//
// An obstacle's cells lie in four parts one after the other, so that those in the colour image are
// the first two and those inside of the image's margins the middle two. Within a part they lie in
// any order: what is made of them is a sum, a minimum, a maximum or a median.
#pragma once
#include "lanes.h"

struct ObstacleCells {
    enum { SHOWN_AT_MARGIN, SHOWN_INSIDE, HIDDEN_INSIDE, HIDDEN_AT_MARGIN, PARTS };
    enum {
        // This part of the columns at each side is the image's margin.
        MARGIN = 8,
        AHEAD = 4,
        LARGEST = 0x7fffffff
    };

    // Cells from the first to before the last in the order below.
    struct Range {
        int first, end;
        int size() const { return end - first; }
    };

    const Team& team;
    int cells, columns, count;  // of the grid; and how many obstacles
    int margin;  // columns of it at a side
    const int *label, *right, *forward;
    const bool* in_view;
    // By obstacle and part, and one more.
    int* starts;
    int* filled;
    // By place in the order: the cell, and where it is on the floor.
    int *cell, *right_of, *forward_of;

    ObstacleCells(const Team& team, int cells, int columns, int count)
        : team(team), cells(cells), columns(columns), count(count), margin(columns / MARGIN) {}

    // Puts the arrays into scratch memory with room for `slots` obstacles.
    void lay(int* scratch, int slots) {
        starts = scratch;
        filled = starts + PARTS * slots + 1;
        cell = filled + PARTS * slots;
        right_of = cell + cells;
        forward_of = right_of + cells;
    }

    bool at_margin(int column) const {
        return column < margin || column >= columns - margin;
    }

    int place(int number, bool shown, int column) const {
        const bool outside = at_margin(column);
        const int part = shown ? (outside ? SHOWN_AT_MARGIN : SHOWN_INSIDE)
                               : (outside ? HIDDEN_AT_MARGIN : HIDDEN_INSIDE);
        return PARTS * number + part;
    }

    // Before the cells are counted; then all threads wait.
    void clear() const {
        for (int i = team.rank; i < PARTS * count; i += team.size) filled[i] = 0;
    }

    // Cells of one obstacle and part, one after the other.
    struct Run {
        int place, size;
    };

    // Counts a cell of an obstacle: it goes on with a run, or the run is counted and one begins.
    void note(Run& run, int own) const {
        if (own != run.place) {
            end(run);
            run = {own, 0};
        }
        ++run.size;
    }

    void end(Run run) const {
        if (run.size) team.add(filled + run.place, run.size);
    }

    // By one thread, after all cells are counted; then all threads wait.
    void order() const {
        int start = 0;
        for (int i = 0; i < PARTS * count; ++i) {
            const int size = filled[i];
            starts[i] = filled[i] = start;
            start += size;
        }
        starts[PARTS * count] = start;
    }

    // Puts the cells in order; then all threads wait.
    void sort() const {
#if defined(__CUDA_ARCH__)
        // Down the columns, AHEAD cells at a time: their loads wait together.
        for (int c = team.rank; c < columns; c += team.size) {
            for (int first = c; first < cells; first += AHEAD * columns) {
                int own[AHEAD], at[AHEAD], x[AHEAD], y[AHEAD];
                bool same = true;
                for (int n = 0; n < AHEAD; ++n) {
                    const int k = first + n * columns, there = k < cells ? k : first;
                    const int number = k < cells ? label[there] : -1;
                    const bool has = number >= 0 && number < count;
                    own[n] = place(number, in_view[there], c);
                    own[n] = has ? own[n] : -1;
                    x[n] = right[there];
                    y[n] = forward[there];
                    same &= own[n] == own[0];
                }
                if (same) {
                    if (own[0] < 0) continue;
                    const int place = team.add(filled + own[0], AHEAD);
                    for (int n = 0; n < AHEAD; ++n) at[n] = place + n;
                } else {
                    for (int n = 0; n < AHEAD; ++n) {
                        if (own[n] >= 0) at[n] = team.add(filled + own[n], 1);
                    }
                }
                for (int n = 0; n < AHEAD; ++n) {
                    if (own[n] < 0) continue;
                    cell[at[n]] = first + n * columns;
                    right_of[at[n]] = x[n];
                    forward_of[at[n]] = y[n];
                }
            }
        }
#else
        Run run = {0, filled[0]};  // the part that the last cell went to, and its end
        for (int k = 0, c = 0; k < cells; ++k, c = c + 1 < columns ? c + 1 : 0) {
            const int number = label[k];
            if (number < 0 || number >= count) continue;
            const int own = place(number, in_view[k], c);
            if (own != run.place) {
                filled[run.place] = run.size;
                run = {own, filled[own]};
            }
            const int i = run.size++;
            cell[i] = k;
            right_of[i] = right[k];
            forward_of[i] = forward[k];
        }
#endif
    }

    Range all(int number) const { return parts(number, SHOWN_AT_MARGIN, PARTS); }
    Range shown(int number) const { return parts(number, SHOWN_AT_MARGIN, HIDDEN_INSIDE); }

    // Those inside of the margins, or all where more than half are there.
    Range relied(int number) const {
        const Range every = all(number), inside = parts(number, SHOWN_INSIDE, HIDDEN_AT_MARGIN);
        return 2 * (every.size() - inside.size()) > every.size() ? every : inside;
    }

    Range parts(int number, int first, int end) const {
        return {starts[PARTS * number + first], starts[PARTS * number + end]};
    }
};
