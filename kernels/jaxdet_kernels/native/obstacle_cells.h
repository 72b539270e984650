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
        LARGEST = 0x7fffffff
    };

    // Cells from the first to before the last in the order below.
    struct Range {
        int first, end;
        int size() const { return end - first; }
    };

    const Team& team;
    int cells, columns, count;  // of the grid; and how many obstacles
    // Columns of the margin at a side; columns from a thread's cell to its next.
    int margin, step;
    const int *label, *right, *forward;
    const bool* in_view;
    // By obstacle and part, and one more.
    int* starts;
    int* filled;
    // By place in the order: the cell, and where it is on the floor.
    int *cell, *right_of, *forward_of;

    ObstacleCells(const Team& team, int cells, int columns, int count)
        : team(team), cells(cells), columns(columns), count(count), margin(columns / MARGIN),
          step(team.size % columns) {}

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

    int place(int number, int k, int column) const {
        const bool outside = at_margin(column);
        const int part = in_view[k] ? (outside ? SHOWN_AT_MARGIN : SHOWN_INSIDE)
                                    : (outside ? HIDDEN_AT_MARGIN : HIDDEN_INSIDE);
        return PARTS * number + part;
    }

    // The column of the cell that a thread looks at after one in `column`.
    int next_column(int column) const {
        column += step;
        return column < columns ? column : column - columns;
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
    void note(Run& run, int number, int k, int column) const {
        const int own = place(number, k, column);
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
        Run run = {0, filled[0]};  // on the CPU: the part that the last cell went to, and its end
        for (int k = team.rank, c = team.rank % columns; k < cells;
             k += team.size, c = next_column(c)) {
            const int number = label[k];
            if (number < 0 || number >= count) continue;
            const int own = place(number, k, c);
#if defined(__CUDA_ARCH__)
            const int i = team.add(filled + own, 1);
#else
            if (own != run.place) {
                filled[run.place] = run.size;
                run = {own, filled[own]};
            }
            const int i = run.size++;
#endif
            cell[i] = k;
            right_of[i] = right[k];
            forward_of[i] = forward[k];
        }
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
