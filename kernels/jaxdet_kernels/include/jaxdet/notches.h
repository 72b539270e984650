// Low obstacles revealed by notches in the free floor. Twin of jaxdet/reference/_notches.py.
#pragma once
#include "free.h"

namespace jaxdet { namespace {

struct Notches {
    const FreeFloor& floor;  // free floor, whose `run` has finished
    const int* settings;
    const unsigned char* half;  // (R, C): whether a cell is above half of the step height
    // Scratch. `notch` is the notch of each column, from left to right, -1 if there is none. `size` is
    // first the number of cells of each notch, then the number of its obstacle, -1 if it has too few
    // cells. `most` is the number of notches.
    int *notch, *size, *most;
    int* label;
    int *num_obstacles, *first;

    // `ahead` is the forward distance at which the floor of column c, counted from the left, ends [depth
    // units], 0 if no floor is visible. `is_short` is true if the floor is visible and ends for an
    // unknown reason.
    int ahead(int c) const { return floor.line_out[4 * c + 3]; }
    bool is_short(int c) const { return floor.end_out[c] == FreeFloor::UNKNOWN && ahead(c) > 0; }

    // Adds an obstacle for each notch with enough cells; returns whether there are any.
    bool run() const {
        const Team& team = floor.team;
        if (team.rank == 0) *most = find();
        team.sync();
        const int found = *most;
        for (int n = team.rank; n < found; n += team.size) size[n] = 0;
        team.sync();
        if (found) each_cell([&](int n, int) { team.atomic_add(size + n, 1); });
        team.sync();
        if (team.rank == 0) {
            int next = *first = *num_obstacles;
            for (int n = 0; n < found; ++n)
                size[n] = size[n] >= settings[FreeFloor::MIN_CELLS] ? next++ : -1;
            *num_obstacles = next;
        }
        team.sync();
        const bool any = *num_obstacles > *first;
        if (any)
            each_cell([&](int n, int k) {
                if (size[n] >= 0) label[k] = size[n];
            });
        team.sync();
        return any;
    }

    // Numbers the notches, i.e. runs of short columns between longer ones; returns how many there are.
    // Only one thread may call it.
    int find() const {
        const int columns = floor.columns, length = settings[FreeFloor::NOTCH];
        int found = 0;
        for (int c = 0; c < columns; ++c) notch[c] = -1;
        for (int c = 1; c < columns;) {
            const int before = ahead(c - 1);
            int last = c, longest = -FreeFloor::LARGEST;
            for (; last < columns && is_short(last) && before - ahead(last) > length; ++last)
                longest = ahead(last) > longest ? ahead(last) : longest;
            if (last > c && last < columns && ahead(last) - longest > length) {
                while (c < last) notch[c++] = found;
                ++found;
            } else {
                ++c;
            }
        }
        return found;
    }

    // Calls `use` with the notch and the index of each cell above half of the step height in a notch.
    template <class Use> void each_cell(Use use) const {
        for (int c = floor.team.rank; c < floor.columns; c += floor.team.size) {
            const int n = notch[c], end = floor.rows * floor.columns, from = ahead(c);
            const int column = floor.turned ? floor.columns - 1 - c : c;
            for (int k = column; n >= 0 && k < end; k += floor.columns) {
                const int z = floor.z[k], high = floor.height[k], beyond = floor.forward[k] - from;
                if (label[k] < 0 && z >= settings[FreeFloor::NEAREST] &&
                    z <= settings[FreeFloor::IN_RANGE] && high <= settings[FreeFloor::HIGHEST] &&
                    half[k] && beyond >= 0 && beyond <= settings[FreeFloor::NOTCH])
                    use(n, k);
            }
        }
    }
};

} }  // namespace jaxdet
