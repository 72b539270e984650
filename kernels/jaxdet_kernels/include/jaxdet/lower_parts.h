// Lower parts of obstacles, below the step height. Twin of jaxdet/reference/_lower_parts.py.
#pragma once
#include "floor_frame.h"
#include "team.h"

namespace jaxdet { namespace {

struct LowerParts {
    int rows, columns;
    const unsigned char* half;    // (R, C): whether a cell is above half of the step height
    const int *forward, *height;  // (R, C)
    int* label;                   // (R, C): obstacles, -1 = none

    // Whether the side of an obstacle continues from a cell to the one below it.
    bool is_steep(int upper, int lower) const {
        const int falls = height[upper] - height[lower], goes = forward[upper] - forward[lower];
        return falls >= (goes < 0 ? -goes : goes);
    }

    // Extends the obstacles. All threads of the team must call it.
    void run(const Team& team, const FloorFrame& frame) const {
        if (!frame.valid || frame.is_on_side()) return;
        const int away = frame.is_upside_down() ? -columns : columns;
        const int first = frame.is_upside_down() ? (rows - 1) * columns : 0;
        for (int r = 1; r < rows; ++r) {
            const int row = first + r * away;
            JAXDET_VECTORIZE
            for (int c = team.rank; c < columns; c += team.size) {
                const int k = row + c, upper = k - away, above = label[upper], own = label[k];
                const bool joins = (above >= 0) & (own < 0) & (half[k] != 0) & is_steep(upper, k);
                label[k] = joins ? above : own;
            }
        }
        team.sync();
    }
};

} }  // namespace jaxdet
