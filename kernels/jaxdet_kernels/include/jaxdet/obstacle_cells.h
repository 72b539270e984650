// The cells of a frame sorted by obstacle (a counting sort).
//
// An obstacle's cells lie in two parts one after the other, those inside of the image's margins
// first. Within a part they lie in any order: what is made of them is a sum, a minimum, a maximum or
// a median.
#pragma once
#include "arena.h"
#include "warp.h"
#include "cell_list.h"
#include "margins.h"

namespace jaxdet { namespace {

struct ObstacleCells {
    enum { INSIDE, AT_MARGIN, PARTS };

    // Cells from the first to before the last in the order below.
    struct Range {
        int first, end;
        int size() const { return end - first; }
    };

    const Team& team;
    int cells, columns, count;  // of the grid; and how many obstacles
    Margins margins;
    const int *label, *right, *forward;
    CellList listed;  // those of obstacles; their label becomes their place
    // By obstacle and part, and one more.
    int* starts;
    int* filled;
    // By place in the order: the cell, and where it is on the floor.
    int *cell, *right_of, *forward_of;

    // Takes the arrays from scratch memory with room for so many obstacles.
    void allocate(Arena& arena, int slots) {
        starts = arena.words(PARTS * slots + 1);
        filled = arena.words(PARTS * slots);
        int** const by_cell[] = {&cell, &right_of, &forward_of, &listed.cell, &listed.label,
                                 &listed.right, &listed.forward};
        for (int** array : by_cell) *array = arena.words(cells);
        listed.count = arena.words(1);
    }

    int place(int number, int column) const {
        return PARTS * number + (margins.has(column) ? AT_MARGIN : INSIDE);
    }

    // Before the cells are counted; then all threads wait.
    void clear() const {
        for (int i = team.rank; i < PARTS * count; i += team.size) filled[i] = 0;
        if (team.rank == 0) *listed.count = 0;
    }

    // By the first warp, after all cells are counted; then all threads wait.
    void order(const Warp& warp) const {
        const int all = PARTS * count;
        for (int i = warp.lane; i < all; i += warp.size) starts[i] = filled[i];
        warp.exclusive_sum(starts, all);
        for (int i = warp.lane; i < all; i += warp.size) filled[i] = starts[i];
    }

    // Puts the cells in order, once their labels are their places; then all threads wait.
    void sort() const {
        for (int i = team.rank; i < *listed.count; i += team.size) {
            const int at = team.atomic_count(filled + listed.label[i]);
            cell[at] = listed.cell[i];
            right_of[at] = listed.right[i];
            forward_of[at] = listed.forward[i];
        }
    }

    Range all(int number) const { return parts(number, INSIDE, PARTS); }

    // Those inside of the margins, or all where more than half are there.
    Range relied(int number) const {
        const Range every = all(number), inside = parts(number, INSIDE, AT_MARGIN);
        return 2 * (every.size() - inside.size()) > every.size() ? every : inside;
    }

    Range parts(int number, int first, int end) const {
        return {starts[PARTS * number + first], starts[PARTS * number + end]};
    }
};

} }  // namespace jaxdet
