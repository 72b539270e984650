// Box of a cell in the image in which boxes are reported: its square in an aligned depth image, or the
// extent of its corners in the colour image. Twin of `cell_boxes` in jaxdet/reference/_cells.py.
#pragma once
#include "projection.h"
#include "warp.h"

namespace jaxdet { namespace {

struct CellBoxes {
    // The image of boxes, relative to that of depth.
    enum Image { ALIGNED, PINHOLE, DISTORTED };
    int columns, side;                 // columns of the grid, and side of a cell [depth pixel]
    const float *corner_x, *corner_y;  // (rows + 1, columns + 1) rays of corners; unused if depth is aligned
    Projection projection;
    const int* last;                   // the image's last column and row
    bool aligned;

    Image image() const {
        return aligned ? ALIGNED : projection.model == Projection::PINHOLE ? PINHOLE : DISTORTED;
    }

    // Writes the box of cell k, measured at depth d: its first and last column, and its first and last
    // row. If it is not in the image, the first is after the last.
    __attribute__((always_inline)) void box(int k, int d, Image image, int* left, int* right, int* top,
                                            int* bottom) const {
        // The rounding error is too small to reach the next row: a grid has at most 2^18 cells.
        const int row = (int)(((float)k + 0.5f) / (float)columns), column = k - row * columns;
        if (image == ALIGNED) {
            *left = column * side, *right = *left + side - 1;
            *top = row * side, *bottom = *top + side - 1;
            return;
        }
        const int upper = row * (columns + 1) + column, lower = upper + columns + 2;
        Projection::Point one, two;
        projection.through(d, corner_x[upper], corner_y[upper], image == DISTORTED, &one);
        projection.through(d, corner_x[lower], corner_y[lower], image == DISTORTED, &two);
        Extremes u, v;
        u.add(one.u), u.add(two.u), v.add(one.v), v.add(two.v);
        const bool in_image = one.seen & two.seen & (u.high >= 0) & (v.high >= 0) &
                              (u.low <= last[0]) & (v.low <= last[1]);
        const Extremes none;
        *left = in_image ? u.low : none.low, *right = in_image ? u.high : none.high;
        *top = in_image ? v.low : none.low, *bottom = in_image ? v.high : none.high;
    }

    // Writes the first and last column or row, clipped to the image; 0 and -1 if no cell is in it.
    static void put(Extremes found, int last, int* first_out, int* last_out) {
        const bool none = found.high < found.low;
        *first_out = none || found.low < 0 ? 0 : found.low;
        *last_out = none ? -1 : found.high < last ? found.high : last;
    }
};

} }  // namespace jaxdet
