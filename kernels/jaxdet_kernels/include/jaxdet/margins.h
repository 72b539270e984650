// The outer columns of a grid of cells at each side, where stereo depth bends. Twin of `margins` in
// jaxdet/reference/_cells.py.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct Margins {
    enum { MARGIN = 8 };  // one in MARGIN columns on each side
    int columns, width;

    explicit Margins(int columns) : columns(columns), width(columns / MARGIN) {}

    bool has(int column) const { return (column < width) | (column >= columns - width); }
};

} }  // namespace jaxdet
