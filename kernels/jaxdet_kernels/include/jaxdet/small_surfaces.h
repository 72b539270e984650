// Merges surfaces that are too small to be an obstacle into the surface they touch most. Twin of
// `whole_surfaces` in jaxdet/reference/_obstacles.py.
#pragma once
#include "cell_list.h"
#include "runs.h"
#include "warp.h"

namespace jaxdet { namespace {

struct SmallSurfaces {
    enum { REACH = 2 };
    int count, rows, columns, step;
    const CellList& listed;
    const int *label, *z;  // surface and depth of each cell
    const int* small;      // whether each surface is too small
    int* touching;         // scratch, (count, count): number of touching cells
    // Input: each surface is its own set. Result, in `parent`: the first surface of each surface's set.
    UnionFind sets;

    // Joins each surface that is too small with the one that it touches most. Ends in a sync.
    void run(const Team& team) const {
        const Warp warp(team);
        for (int a = warp.index; a < count; a += warp.count)
            for (int b = warp.lane; small[a] && b < count; b += warp.size)
                touching[a * count + b] = 0;
        team.sync();
        touch(team);
        team.sync();
        for (int a = warp.index; a < count; a += warp.count) {
            int most = 0;
            for (int b = warp.lane; small[a] && b < count; b += warp.size) {
                most = touching[a * count + b] > most ? touching[a * count + b] : most;
            }
            most = warp.max(most);
            int partner = most ? count : a;
            for (int b = warp.lane; most && b < partner; b += warp.size) {
                if (touching[a * count + b] == most) partner = b;
            }
            partner = warp.min(partner);
            if (warp.lane == 0) sets.link(team, a, partner);
        }
        team.sync();
        for (int a = team.rank; a < count; a += team.size) sets.parent[a] = sets.root(a);
        team.sync();
    }

    // Counts the cells of small surfaces that touch other surfaces: in the next cell or the one after
    // it, on all four sides.
    void touch(const Team& team) const {
        const int all = *listed.count;
        for (int i = team.rank; i < all; i += team.size) {
            const int a = listed.label[i];
            if (!small[a]) continue;
            const int k = listed.cell[i], row = k / columns, c = k - row * columns;
            const auto meet = [&](bool inside, int there) {
                const int b = inside ? label[there] : -1;
                if (b < 0 || b == a) return;
                const int apart = z[there] - z[k];
                if (apart <= step && apart >= -step) team.atomic_add(touching + a * count + b, 1);
            };
            for (int away = 1; away <= REACH; ++away) {
                meet(c >= away, k - away);
                meet(c + away < columns, k + away);
                meet(row >= away, k - away * columns);
                meet(row + away < rows, k + away * columns);
            }
        }
    }
};

} }  // namespace jaxdet
