// Layout of planes of cells with a margin.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

// The outer columns of a grid of cells at each side, where stereo depth bends. Twin of `margins` in
// jaxdet/reference/_cells.py.
struct Margins {
    enum { MARGIN = 8 };  // inverse of the fraction of columns on each side
    int columns, width;

    explicit Margins(int columns) : columns(columns), width(columns / MARGIN) {}

    bool has(int column) const { return (column < width) | (column >= columns - width); }
};

// Layout of R rows and C columns of cells in a plane of scratch memory with one more row above and
// below and PAD more columns on both sides. The columns to the right of a row are the same memory as the
// columns to the left of the next row.
struct Grid {
    enum { PAD = 16, MOST_COLUMNS = 512 };
    int rows, columns, stride, size;

    Grid(int rows, int columns)
        : rows(rows), columns(columns), stride(columns + PAD), size((rows + 2) * stride + PAD) {}

    // Index of the first cell of row r, -1 .. R.
    int row(int r) const { return (r + 1) * stride + PAD; }

    // Fills the margin with `value`; the right margin of a row is the left margin of the next.
    void frame(const Team& team, int* plane, int value) const {
        const int last = row(rows);
        for (int i = team.rank; i < row(0); i += team.size) plane[i] = value;
        for (int i = team.rank; i < size - last; i += team.size) plane[last + i] = value;
        for (int i = team.rank; i < rows * PAD; i += team.size)
            plane[row(i / PAD) + columns + i % PAD] = value;
    }
};

} }  // namespace jaxdet
