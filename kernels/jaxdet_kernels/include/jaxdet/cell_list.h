// Compacted list of the labelled cells of a frame, usually a small fraction of all cells.
#pragma once
#include "bits.h"
#include "warp.h"

namespace jaxdet { namespace {

struct CellList {
    enum { AHEAD = 4 };  // number of words whose cells a warp on CUDA loads at a time
    int* count;
    // Index, label and position on the floor of each listed cell. On the CPU cells are in raster order;
    // on CUDA, cells are listed in groups of AHEAD words, and the groups are in any order.
    int *cell, *label, *right, *forward;

    // Lists all cells with a label. Also writes the bitmaps of labelled cells to `has` and of free
    // cells to `open`, copies the labels to `out`, and raises `most` to at least the largest label plus
    // one. `count` and `most` must be 0 before the call. Ends in a sync.
    void take(
        const Team& team, const int* labels, const unsigned char* free, const int* at_right,
        const int* at_forward, int columns, const BitRows& has, const BitRows& open, int* out,
        int* most
    ) const {
        int largest = -1;
        has.clear_padding(team);
        open.clear_padding(team);
#if defined(__CUDA_ARCH__)
        const Warp warp(team);
        const int words = has.words, all = has.rows * words;
        for (int first = warp.index * AHEAD; first < all; first += warp.count * AHEAD) {
            int own[AHEAD], from[AHEAD];
            bool seen[AHEAD];
            for (int k = 0; k < AHEAD; ++k) {
                const int i = first + k, c = i % words * BitRows::WIDTH + warp.lane;
                from[k] = i < all && c < columns ? i / words * columns + c : -1;
                own[k] = from[k] < 0 ? -1 : labels[from[k]];
                seen[k] = from[k] >= 0 && free[from[k]];
            }
            for (int k = 0; k < AHEAD; ++k) {
                const unsigned those = warp.ballot(own[k] >= 0), frees = warp.ballot(seen[k]);
                if (from[k] >= 0) out[from[k]] = own[k];
                largest = own[k] > largest ? own[k] : largest;
                const int i = has.at((first + k) / words, (first + k) % words);
                if (warp.lane || first + k >= all) continue;
                has[i] = those;
                open[i] = frees;
            }
            append(team, warp, own, from, at_right, at_forward);
        }
#else
        int n = 0;
        for (int i = 0; i < has.count(); ++i) {
            const int from = has.row(i) * columns + has.column(i), left = columns - has.column(i);
            const int wide = left < BitRows::WIDTH ? left : (int)BitRows::WIDTH;
            if (wide <= 0) continue;
            for (int k = 0; k < wide; ++k) out[from + k] = labels[from + k];
            has[i] = BitRows::labelled(labels + from, wide);
            open[i] = BitRows::packed(free + from, 0, wide);
            for (unsigned those = has[i]; those; those &= those - 1) {
                const int at = from + BitRows::lowest(those), own = labels[at];
                put(n++, at, own, at_right, at_forward);
                largest = own > largest ? own : largest;
            }
        }
        *count = n;
#endif
        if (largest >= 0) team.atomic_max(most, largest + 1);
        team.sync();
    }

    // Lists those of the first `cells` cells that have labels 0 .. limit - 1, and writes nothing else.
    // `count` must be 0 before the call. Ends in a sync.
    void take(
        const Team& team, int cells, const int* labels, int limit, const int* at_right,
        const int* at_forward
    ) const {
#if defined(__CUDA_ARCH__)
        enum { GROUP = AHEAD * Warp::size };
        const Warp warp(team);
        for (int first = warp.index * GROUP; first < cells; first += warp.count * GROUP) {
            int own[AHEAD], from[AHEAD];
            for (int k = 0; k < AHEAD; ++k) {
                from[k] = first + k * Warp::size + warp.lane;
                own[k] = from[k] < cells ? labels[from[k]] : -1;
            }
            for (int k = 0; k < AHEAD; ++k) own[k] = own[k] < limit ? own[k] : -1;
            append(team, warp, own, from, at_right, at_forward);
        }
#else
        int n = 0;
        for (int first = 0; first < cells; first += BitRows::WIDTH) {
            const int wide = cells - first < BitRows::WIDTH ? cells - first : (int)BitRows::WIDTH;
            for (unsigned some = BitRows::labelled(labels + first, wide); some; some &= some - 1) {
                const int i = first + BitRows::lowest(some);
                if (labels[i] < limit) put(n++, i, labels[i], at_right, at_forward);
            }
        }
        *count = n;
#endif
        team.sync();
    }

#if defined(__CUDA_ARCH__)
    // Appends the cells with a label, among the AHEAD cells of each lane, to the list.
    void append(
        const Team& team, const Warp& warp, const int* own, const int* from, const int* at_right,
        const int* at_forward
    ) const {
        int before[AHEAD], found, sum = 0, start = 0;
        for (int k = 0; k < AHEAD; ++k) {
            before[k] = sum + warp.ballot_rank(own[k] >= 0, &found);
            sum += found;
        }
        if (sum == 0) return;
        if (warp.lane == 0) start = team.atomic_add(count, sum);
        start = warp.broadcast(start, 0);
        for (int k = 0; k < AHEAD; ++k)
            if (own[k] >= 0) put(start + before[k], from[k], own[k], at_right, at_forward);
    }
#endif

    void put(int i, int from, int own, const int* at_right, const int* at_forward) const {
        cell[i] = from;
        label[i] = own;
        right[i] = at_right[from];
        forward[i] = at_forward[from];
    }
};

} }  // namespace jaxdet
