// Column and row of a pixel as two int16 in one word; both are below 2^15.
#pragma once

namespace jaxdet {
namespace {

struct PixelPair {
    int word;

    PixelPair(int word) : word(word) {}
    PixelPair(int column, int row) : word(column | row << 16) {}
    int column() const { return word & 0xffff; }
    int row() const { return word >> 16; }
};

}  // namespace
}  // namespace jaxdet
