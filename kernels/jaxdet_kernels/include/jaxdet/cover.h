// The colour pixels under kept cells, the nearest kept cell over a corner, and a sample of the cells.
// Twin of `cover` in jaxdet/reference/_cells.py and of `_points` in jaxdet/reference/_detect.py. A
// cell covers its box, a pixel wider at each side.
#pragma once
#include "bits.h"
#include "warp.h"
#include "pixel_bits.h"
#include "pixel_pair.h"

namespace jaxdet {
namespace {

struct Cover {
    Team team;
    int height, width;           // Of the colour image.
    int cells;                   // Of the grid.
    const bool *keep, *in_view;  // (cells)
    const int *z, *low, *high;   // (cells): depth; a `PixelPair` each, first and last pixel.
    const int* range;            // (2), least and largest depth; of kept cells only the second counts.
    int *count, *taken;          // (), (cells): how many take part, and which, in no order.

    struct Box {
        int left, top, right, bottom;

        bool is_empty() const { return (left > right) | (top > bottom); }
    };

    Box box(PixelPair first, PixelPair last) const {
        const int left = first.column() - 1, top = first.row() - 1;
        const int right = last.column() + 1, bottom = last.row() + 1;
        return {left < 0 ? 0 : left, top < 0 ? 0 : top, right < width ? right : width - 1,
                bottom < height ? bottom : height - 1};
    }
};

// Which cells take part, and the pixels under them.
struct CoverMask {
    enum { GROUP = 8 };  // cells that are looked at together, since most are not kept

    Cover cover;
    unsigned* bits;  // (height, PixelBits::words(width)): whether a pixel lies under a kept cell.

    // Whether any cell in view is in range; all threads get it.
    bool run() const {
        const Team& team = cover.team;
        const int all = cover.height * PixelBits::words(cover.width);
        for (int i = team.rank; i < all; i += team.size) bits[i] = 0;
        return team.any(take()) || any_in_range();
    }

    // Lists the cells that take part and paints their pixels; whether one of this thread's is in
    // range.
    bool take() const {
        bool some = false;
        const Team& team = cover.team;
#if defined(__CUDA_ARCH__)
        __shared__ int listed;
#else
        int listed;
#endif
        const Warp warp(team);
        if (team.rank == 0) listed = 0;
        team.sync();
        // Groups begin where 64-bit words do.
        const int before = (int)((size_t)cover.keep % GROUP);
        const int groups = (before + cover.cells + GROUP - 1) / GROUP;
        for (int start = 0; start < groups; start += team.size) {
            const int group = start + team.rank, first = group * GROUP - before;
            unsigned those = group < groups ? group_of(first, &some) : 0;
            const int up_to = warp.inclusive_sum(BitRows::popcount(those));
            int place = 0;
            if (warp.lane == Warp::size - 1 && up_to) place = team.atomic_add(&listed, up_to);
            place = warp.broadcast(place, Warp::size - 1) + up_to - BitRows::popcount(those);
            if (those) paint(first, those);
            for (; those; those &= those - 1)
                cover.taken[place++] = first + BitRows::lowest(those);
        }
        team.sync();
        if (team.rank == 0) *cover.count = listed;
        return some;
    }

    // Bit k: cell `first + k` takes part. `some` becomes true where one of these is in range.
    unsigned group_of(int first, bool* some) const {
        typedef unsigned long long Eight;
        const bool *kept = cover.keep + first, *seen = cover.in_view + first;
        unsigned those = 0, taken = 0;
        if (first >= 0 && first + GROUP <= cover.cells && (size_t)seen % GROUP == 0) {
            those = PixelBits::packed(Team::input((const Eight*)kept) &
                                      Team::input((const Eight*)seen));
        } else {
            for (int k = 0; k < GROUP; ++k)
                if (first + k >= 0 && first + k < cover.cells && kept[k] && seen[k])
                    those |= 1u << k;
        }
        if (those == 0) return 0;
        const int nearest = cover.range[0], farthest = cover.range[1];
        int depth[GROUP];
        for (int k = 0; k < GROUP; ++k)
            depth[k] = those >> k & 1 ? cover.z[first + k] : 0;
        for (int k = 0; k < GROUP; ++k) {
            const bool is_taken = (those >> k & 1) & (depth[k] <= farthest);
            taken |= (unsigned)is_taken << k;
            *some |= is_taken & (depth[k] >= nearest);
        }
        return taken;
    }

    bool any_in_range() const {
        const Team& team = cover.team;
        const int nearest = cover.range[0], farthest = cover.range[1];
        bool some = false;
        for (int i = team.rank; i < cover.cells; i += team.size)
            some |= cover.in_view[i] & (cover.z[i] >= nearest) & (cover.z[i] <= farthest);
        return team.any(some);
    }

    // Of a group of cells: bit k says whether to paint cell `first + k`. Boxes of the same rows that
    // meet, as those of neighbours mostly do, are painted as one.
    void paint(int first, unsigned those) const {
        int low[GROUP], high[GROUP];
        for (int k = 0; k < GROUP; ++k) {
            low[k] = those >> k & 1 ? cover.low[first + k] : 0;
            high[k] = those >> k & 1 ? cover.high[first + k] : 0;
        }
        Cover::Box joined = {0, 0, -1, -1};
        for (int k = 0; k < GROUP; ++k) {
            const Cover::Box at = cover.box(low[k], high[k]);
            if (!(those >> k & 1) || at.is_empty()) continue;
            if (at.top == joined.top && at.bottom == joined.bottom && at.left >= joined.left &&
                at.left <= joined.right + 1) {
                joined.right = at.right > joined.right ? at.right : joined.right;
                continue;
            }
            fill(joined);
            joined = at;
        }
        fill(joined);
    }

    void fill(Cover::Box at) const {
        const int words = PixelBits::words(cover.width);
        if (at.is_empty()) return;
        for (int w = at.left / 32; w <= at.right / 32; ++w) {
            const unsigned part = PixelBits::part(w, at.left, at.right);
            for (int v = at.top; v <= at.bottom; ++v)
                cover.team.atomic_or((int*)&bits[v * words + w], (int)part);
        }
    }
};

// The features of a frame, by slot.
struct FeatureSlots {
    int *u, *v, *x, *y, *z, *label;
    bool *valid, *kept;
    int most;  // Labels from here on become -1.

    void put(
        int i, int column, int row, int right, int down, int depth, int own, bool is_valid,
        bool is_kept
    ) const {
        u[i] = column;
        v[i] = row;
        valid[i] = is_valid;
        x[i] = right;
        y[i] = down;
        z[i] = depth;
        label[i] = own < most ? own : -1;
        kept[i] = is_kept;
    }
};

// Every second cell of every second row.
struct SampledCells {
    Cover cover;
    int rows, columns;
    const int *x, *y, *label;  // (cells)
    FeatureSlots out;
    int first;                 // Its slot of the first of them.

    void run() const {
        const Warp warp(cover.team);
        const int across = columns / 2, farthest = cover.range[1];
        for (int row = warp.index; row < rows / 2; row += warp.count) {
            const int from = (2 * row + 1) * columns + 1, to = first + row * across;
#if defined(__clang__)
#pragma clang loop vectorize(assume_safety)
#endif
            for (int i = warp.lane; i < across; i += Warp::size) {
                const int k = from + 2 * i;
                const bool seen = Team::input(cover.in_view + k);
                const int right = Team::input(x + k), down = Team::input(y + k);
                const int depth = Team::input(cover.z + k), own = Team::input(label + k);
                const bool is_kept = seen & Team::input(cover.keep + k) &
                                     ((depth <= farthest) | (own >= 0));
                const PixelPair low(Team::input(cover.low + k)), high(Team::input(cover.high + k));
                out.put(to + i, (low.column() + high.column()) >> 1, (low.row() + high.row()) >> 1,
                        right, down, depth, seen ? own : -1, is_kept, is_kept);
            }
        }
    }
};

// Corners are listed by square tiles of the image; a cell's box asks those that it overlaps.
struct CoveredCorners {
    Cover cover;
    int count, slots;         // Corners, and what there is room for.
    const int *u, *v;         // (slots)
    int* words;               // Scratch: 3 slots, and the tiles.
    const int* label;         // (cells)
    const int *ray_x, *ray_y; // (height, width), fixed point of RAY_BITS.
    // Of each corner: the depth and the label of the nearest cell over it, of equal ones the first,
    // and its coordinates; 0 and -1 without one.
    FeatureSlots out;

    enum {
        CELL_BITS = 18,
        TILE = 8,
        RAY_BITS = 20,
        AHEAD = Warp::size > 1 ? 4 : 1  // the loads of so many cells wait together
    };

    void run() const {
        const Team& team = cover.team;
        const int across = (cover.width + TILE - 1) / TILE;
        const int tiles = (cover.height + TILE - 1) / TILE * across;
        // Keys depth << CELL_BITS | cell come first, for they have 64 bits.
        unsigned long long* nearest = (unsigned long long*)words;
        int *next = words + 2 * slots, *first = next + slots;
        const unsigned long long nothing = ~0ull;
        for (int i = team.rank; i < tiles; i += team.size) first[i] = -1;
        for (int i = team.rank; i < slots; i += team.size) nearest[i] = nothing;
        team.sync();
        for (int i = team.rank; i < count; i += team.size)
            next[i] = team.atomic_exchange(&first[v[i] / TILE * across + u[i] / TILE], i);
        team.sync();
        const int all = *cover.count;
        for (int start = team.rank; start < all; start += AHEAD * team.size) {
            int cell[AHEAD], low[AHEAD], high[AHEAD], depth[AHEAD];
            for (int n = 0; n < AHEAD; ++n) {
                const int k = start + n * team.size;
                cell[n] = k < all ? cover.taken[k] : -1;
            }
            for (int n = 0; n < AHEAD; ++n) {
                low[n] = cell[n] < 0 ? 0 : cover.low[cell[n]];
                high[n] = cell[n] < 0 ? 0 : cover.high[cell[n]];
                depth[n] = cell[n] < 0 ? 0 : cover.z[cell[n]];
            }
            for (int n = 0; n < AHEAD; ++n) {
                const Cover::Box at = cover.box(low[n], high[n]);
                if (cell[n] < 0 || at.is_empty()) continue;
                const unsigned long long key =
                    (unsigned long long)depth[n] << CELL_BITS | (unsigned)cell[n];
                for (int row = at.top / TILE; row <= at.bottom / TILE; ++row)
                    for (int column = at.left / TILE; column <= at.right / TILE; ++column)
                        for (int i = first[row * across + column]; i >= 0; i = next[i]) {
                            const bool is_under = (at.left <= u[i]) & (u[i] <= at.right) &
                                (at.top <= v[i]) & (v[i] <= at.bottom);
                            if (is_under) team.atomic_min(&nearest[i], key);
                        }
            }
        }
        team.sync();
        for (int i = team.rank; i < slots; i += team.size) {
            const int column = Team::input(u + i), row = Team::input(v + i);
            const int pixel = row * cover.width + column;
            const int right = Team::input(ray_x + pixel), down = Team::input(ray_y + pixel);
            const bool is_covered = nearest[i] != nothing;
            const int cell = (int)(nearest[i] & ((1ull << CELL_BITS) - 1));
            const int depth = is_covered ? Team::input(cover.z + cell) : 0;
            const int own = is_covered ? Team::input(label + cell) : -1;
            out.put(i, column, row, lateral(right, depth), lateral(down, depth), depth, own,
                    i < count, is_covered);
        }
    }

    // As in jaxdet/reference/_features.py.
    static int lateral(int ray, int z) {
        return (int)(((long long)ray * z + (1 << (RAY_BITS - 1))) >> RAY_BITS);
    }
};

}  // namespace
}  // namespace jaxdet
