// Box of a cell in the image in which boxes are reported: its square in an aligned depth image, or the
// extent of its corners in the colour image. Twin of `cell_boxes` in jaxdet/reference/_cells.py.
#pragma once
#include "projection.h"
#include "warp.h"

namespace jaxdet { namespace {

struct CellBoxes {
    int columns, side;                 // columns of the grid, and side of a cell [depth pixel]
    const float *corner_x, *corner_y;  // (rows + 1, columns + 1); unused if depth is aligned
    Projection projection;
    const int* last;                   // the image's last column and row
    bool aligned;

    // Extends `across` (columns) and `down` (rows) by cell k, measured at depth d.
    void add(int k, int d, Extremes* across, Extremes* down) const {
        const int row = k / columns, column = k - row * columns;
        if (aligned) {
            across->add(column * side, column * side + side - 1);
            down->add(row * side, row * side + side - 1);
            return;
        }
        const int upper = row * (columns + 1) + column, lower = upper + columns + 2;
        const bool bends = projection.model != Projection::PINHOLE;
        Projection::Point one, two;
        projection.through(d, corner_x[upper], corner_y[upper], bends, &one);
        projection.through(d, corner_x[lower], corner_y[lower], bends, &two);
        Extremes u, v;
        u.add(one.u), u.add(two.u), v.add(one.v), v.add(two.v);
        if (!(one.seen & two.seen) || u.high < 0 || v.high < 0 || u.low > last[0] || v.low > last[1])
            return;
        across->add(u.low, u.high);
        down->add(v.low, v.high);
    }

    // Writes the first and last column or row, clipped to the image; 0 and -1 if no cell is in it.
    static void put(Extremes found, int last, int* first_out, int* last_out) {
        const bool none = found.high < found.low;
        *first_out = none || found.low < 0 ? 0 : found.low;
        *last_out = none ? -1 : found.high < last ? found.high : last;
    }
};

} }  // namespace jaxdet
