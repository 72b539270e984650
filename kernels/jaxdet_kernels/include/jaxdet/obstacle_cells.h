// The cells of a frame sorted by obstacle (a counting sort).
//
// The cells of an obstacle form two parts, first those inside the margins of the image, then those in
// the margins. The order within a part is arbitrary, because only sums, minima, maxima and medians are
// computed.
#pragma once
#include "arena.h"
#include "warp.h"
#include "cell_list.h"
#include "margins.h"

namespace jaxdet { namespace {

struct ObstacleCells {
    enum { INSIDE, AT_MARGIN, PARTS };

    // Range of cells in sorted order; `end` is exclusive.
    struct Range {
        int first, end;
        int size() const { return end - first; }
    };

    const Team& team;
    int cells, columns, count;  // size of the grid, and number of obstacles
    Margins margins;
    const int *label, *right, *forward;
    CellList listed;  // cells of obstacles; the label is replaced by the part's index
    // `starts` has, for each part of each obstacle, the index of its first cell in sorted order, then
    // the number of all cells. `filled` has the index at which the next cell of each part is stored.
    int* starts;
    int* filled;
    // Index and position on the floor of each cell, in sorted order.
    int *cell, *right_of, *forward_of;

    // Allocates the arrays, with room for `slots` obstacles.
    void allocate(Arena& arena, int slots) {
        take(arena, PARTS * slots + 1, starts, filled);
        take(arena, cells, cell, right_of, forward_of);
        listed.allocate(arena, cells / columns, columns);
    }

    int place(int number, int column) const {
        return PARTS * number + (margins.has(column) ? AT_MARGIN : INSIDE);
    }

    // Clears the counts. The team must sync afterwards.
    void clear() const {
        for (int i = team.rank; i < PARTS * count; i += team.size) filled[i] = 0;
    }

    // Lists the cells of obstacles. Ends in a sync.
    void list() const {
        Warp(team).fill(listed.has, [&](int i, int k) {
            const int own = label[listed.has.cell(i, k)];
            return (own >= 0) & (own < count);
        });
        team.sync();
        listed.list(team, label, right, forward);
    }

    // Computes `starts` in one warp; the cells of each part must have been counted. The team must sync
    // afterwards.
    void order(const Warp& warp) const {
        const int all = PARTS * count;
        for (int i = warp.lane; i < all; i += warp.size) starts[i] = filled[i];
        warp.exclusive_sum(starts, all);
        for (int i = warp.lane; i < all; i += warp.size) filled[i] = starts[i];
    }

    // Sorts the cells; their labels must have been replaced by parts. The team must sync afterwards.
    void sort() const {
        for (int i = team.rank; i < *listed.count; i += team.size) {
            const int at = team.atomic_count(filled + listed.label[i]);
            cell[at] = listed.cell[i];
            right_of[at] = listed.right[i];
            forward_of[at] = listed.forward[i];
        }
    }

    Range all(int number) const { return parts(number, INSIDE, PARTS); }

    // Cells of an obstacle inside the margins, or all of its cells if more than half are in the
    // margins.
    Range relied(int number) const {
        const Range every = all(number), inside = parts(number, INSIDE, AT_MARGIN);
        return 2 * (every.size() - inside.size()) > every.size() ? every : inside;
    }

    Range parts(int number, int first, int end) const {
        return {starts[PARTS * number + first], starts[PARTS * number + end]};
    }
};

} }  // namespace jaxdet
