// Sizes of obstacles: extents of their cells in space and in the image in which boxes are reported, and
// their points A, B and C on the floor. Twin of jaxdet/reference/_measures.py.
#pragma once
#include "obstacle_cells.h"
#include "projection.h"
#include "ranks.h"
#include "warp.h"

namespace jaxdet { namespace {

// Box of a cell in the image in which boxes are reported: its square in an aligned depth image, or the
// extent of its corners in the colour image. Twin of `cell_boxes` in jaxdet/reference/_cells.py.
struct CellBoxes {
    // How the image in which boxes are reported relates to the depth image.
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
    // row. If the cell is not in the image, the first is after the last.
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

struct Measures {
    enum { MOST_LATERAL = (1 << 18) - 1, DEPTHS = 65536, TRIM_SHARE = 16 };
    // Number of cells whose boxes are computed together, in a vectorized loop on the CPU.
    enum { ABREAST = Warp::size > 1 ? 1 : 64 };
    // Measurements of an obstacle; each is a unit of work for a warp. LEFT, RIGHT and NEAR are A, B and
    // C.
    enum { PLACE, BOX, LEFT, RIGHT, NEAR, KINDS };

    const ObstacleCells& cells;
    const Warp& warp;
    // Maximum number of outermost cells that are trimmed; minimum distance of C in front of A and B at
    // which C is a vertex [depth units].
    int trim, threshold;
    const int* bands;  // (DEPTHS, 2) widths of the lateral and the forward band, by nearest distance
    // Positions of the cells in the camera optical frame, and their heights [depth units].
    const int *xyz[3], *height;
    CellBoxes boxes;
    // Results, one row per slot, which the caller must set to 0; see `Obstacles` in jaxdet/types.py.
    int *count_out, *uv_min_out, *uv_max_out, *xyz_min_out, *xyz_max_out, *xyz_sum_out;
    int *a_out, *b_out, *c_out, *bottom_top_out;
    int* vertex_out;

    static int clipped(int value) {
        return value < -MOST_LATERAL ? -MOST_LATERAL : value > MOST_LATERAL ? MOST_LATERAL : value;
    }

    // Writes whether C is a vertex, for each obstacle; A, B and C must have been written.
    void find_vertices() const {
        for (int i = cells.team.rank; i < cells.count; i += cells.team.size) {
            const int a = a_out[2 * i + 1], b = b_out[2 * i + 1];
            const bool some = cells.all(i).size() > 0;
            vertex_out[i] = some && (a < b ? a : b) - c_out[2 * i + 1] >= threshold;
        }
    }

    // Writes one measurement of an obstacle; `cells` must be sorted by obstacle.
    void measure(int number, int kind) const {
        const ObstacleCells::Range all = cells.all(number);
        if (all.size() == 0)
            return;
        else if (kind == PLACE)
            put_place(number, all);
        else if (kind == BOX)
            put_box(number, all);
        else
            put_corner(number, kind, all);
    }

    // Writes the number of cells, the extremes and sums of their camera coordinates, and the extremes of
    // their heights.
    void put_place(int number, ObstacleCells::Range range) const {
        Extremes found[3], heights;
        long long sum[3] = {0, 0, 0};
        for (int i = range.first + warp.lane; i < range.end; i += warp.size) {
            const int k = cells.cell[i];
            for (int j = 0; j < 3; ++j) {
                found[j].add(xyz[j][k]);
                sum[j] += xyz[j][k];
            }
            heights.add(height[k]);
        }
        put(heights, bottom_top_out + 2 * number, bottom_top_out + 2 * number + 1);
        for (int j = 0; j < 3; ++j) {
            put(found[j], xyz_min_out + 3 * number + j, xyz_max_out + 3 * number + j);
            const long long total = warp.sum(sum[j]);
            int* out = xyz_sum_out + 2 * (3 * number + j);
            out[0] = (int)(total >> 16);
            out[1] = (int)(total & 0xffff);
        }
        count_out[number] = range.size();
    }

    // Joins the extremes of the lanes of the warp, and writes them.
    void put(Extremes found, int* low, int* high) const {
        found.join(warp);
        *low = found.low;
        *high = found.high;
    }

    // Writes the bounding box of an obstacle, in pixels of the image in which boxes are reported.
    void put_box(int number, ObstacleCells::Range range) const {
        Extremes across, down;
#if defined(__CUDA_ARCH__)
        add_boxes(range, boxes.image(), across, down);
#else
        // Each call has a constant as the image, so that its loops are vectorized.
        switch (boxes.image()) {
            case CellBoxes::ALIGNED: add_boxes(range, CellBoxes::ALIGNED, across, down); break;
            case CellBoxes::PINHOLE: add_boxes(range, CellBoxes::PINHOLE, across, down); break;
            default: add_boxes(range, CellBoxes::DISTORTED, across, down);
        }
#endif
        across.join(warp);
        down.join(warp);
        CellBoxes::put(across, boxes.last[0], uv_min_out + 2 * number, uv_max_out + 2 * number);
        CellBoxes::put(down, boxes.last[1], uv_min_out + 2 * number + 1, uv_max_out + 2 * number + 1);
    }

    // Extends `across` (columns) and `down` (rows) by the boxes of this lane's cells.
    __attribute__((always_inline)) void add_boxes(ObstacleCells::Range range, CellBoxes::Image image,
                                                  Extremes& across, Extremes& down) const {
        const int *cell = cells.cell, *depth = xyz[2];
        const CellBoxes boxes = this->boxes;
        for (int from = range.first + warp.lane * ABREAST; from < range.end;
             from += warp.size * ABREAST) {
            int left[ABREAST], right[ABREAST], top[ABREAST], bottom[ABREAST];
            const int n = range.end - from < ABREAST ? range.end - from : (int)ABREAST;
            JAXDET_VECTORIZE
            for (int i = 0; i < n; ++i) {
                const int k = cell[from + i];
                boxes.box(k, depth[k], image, left + i, right + i, top + i, bottom + i);
            }
            for (int i = 0; i < n; ++i) across.add(left[i], right[i]), down.add(top[i], bottom[i]);
        }
    }

    // Smallest and largest of `values`, which are in the order of the sorted cells.
    Extremes extremes(const int* values, ObstacleCells::Range range) const {
        Extremes found;
        for (int i = range.first + warp.lane; i < range.end; i += warp.size) found.add(values[i]);
        found.join(warp);
        return found;
    }

    // Writes A, B or C. Its coordinate on one axis is that of `outermost`; its coordinate on the other
    // axis is the smallest among the cells with this coordinate.
    void put_corner(int number, int kind, ObstacleCells::Range range) const {
        const bool near = kind == NEAR;
        const int* values = near ? cells.forward_of : cells.right_of;
        const int* others = near ? cells.right_of : cells.forward_of;
        const Extremes ahead = extremes(cells.forward_of, range);
        const Extremes own = near ? ahead : extremes(values, range);
        const int nearest = clipped(ahead.low);
        const int row = nearest < 0 ? 0 : nearest < DEPTHS ? nearest : DEPTHS - 1;
        const int best = outermost(values, kind == RIGHT ? -1 : 0, own, bands[2 * row + near], range);
        int least = MOST_LATERAL;
        for (int i = range.first + warp.lane; i < range.end; i += warp.size) {
            const int other = clipped(others[i]);
            least = clipped(values[i]) == best && other < least ? other : least;
        }
        least = warp.min(least);
        if (warp.lane) return;
        int* out = (kind == LEFT ? a_out : kind == RIGHT ? b_out : c_out) + 2 * number;
        out[near] = best;
        out[!near] = least;
    }

    // Removes the outermost values (at most `trim`, and at most one in TRIM_SHARE), and returns the
    // median of the remaining values that are within `band` of the outermost one. With `flip` 0 the
    // outermost value is the smallest, with `flip` -1 the largest.
    int outermost(const int* values, int flip, Extremes all, int band,
                  ObstacleCells::Range range) const {
        const Ranks ranks(warp);
        const int share = range.size() / TRIM_SHARE, passed = trim < share ? trim : share;
        const int first = clipped(flip ? all.high : all.low) ^ flip;
        const int last = clipped(flip ? all.low : all.high) ^ flip;
        const int start = ranks.at(values, flip, range.first, range.end, passed, first, last);
        if (last - start <= band) {
            const int place = (passed + range.size() - 1) / 2;
            return ranks.at(values, flip, range.first, range.end, place, start, last) ^ flip;
        }
        const int limit = start + band;
        const int inside = ranks.up_to(values, flip, range.first, range.end, limit);
        const int place = (passed + inside - 1) / 2;
        return ranks.at(values, flip, range.first, range.end, place, start, limit) ^ flip;
    }
};

} }  // namespace jaxdet
