// Planes of a frame's cells with a margin around.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

// Where the cells of R rows and C columns are in a plane of scratch memory that has one more row
// above and below and PAD more columns at both sides. The columns right of a row are those left of
// the next one.
struct Grid {
    enum { PAD = 16, MOST_COLUMNS = 512 };
    int rows, columns, stride, size;

    Grid(int rows, int columns)
        : rows(rows), columns(columns), stride(columns + PAD), size((rows + 2) * stride + PAD) {}

    // The first cell of row r, -1 .. R.
    int row(int r) const { return (r + 1) * stride + PAD; }

    // What lies outside of the rows becomes `value`; a row's right margin is the next one's left.
    void frame(const Team& team, int* plane, int value) const {
        const int last = row(rows);
        for (int i = team.rank; i < row(0); i += team.size) plane[i] = value;
        for (int i = team.rank; i < size - last; i += team.size) plane[last + i] = value;
        for (int i = team.rank; i < rows * PAD; i += team.size)
            plane[row(i / PAD) + columns + i % PAD] = value;
    }
};

} }  // namespace jaxdet
