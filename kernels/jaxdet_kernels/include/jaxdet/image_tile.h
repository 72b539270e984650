// A block's tile of an image of a batch, on CUDA. Tiles of an image follow each other row by row.
#pragma once
#include "team.h"

namespace jaxdet { namespace {

struct ImageTile {
    int image, top, left;

    ImageTile(const Team& team, int rows, int columns, int height, int width) {
        const int across = (width + columns - 1) / columns;
        const int tiles = across * ((height + rows - 1) / rows), tile = team.index % tiles;
        image = team.index / tiles;
        top = tile / across * rows;
        left = tile % across * columns;
    }
};

} }  // namespace jaxdet
