// Surfaces too small to be an obstacle join the one they touch most.
// Twin of `whole_surfaces` in jaxdet/reference/_obstacles.py.
#pragma once
#include "lanes.h"
#include "listed.h"
#include "numbering.h"

struct Pieces {
    enum { REACH = 2 };
    int count, rows, columns, step;
    const Listed& listed;
    const int *label, *z;  // of each cell
    const int* small;        // of each surface
    int *touching, *joined;  // scratch: `count` words for each surface; a word a surface
    int* group;              // result: the smallest surface of each one's group

    // Ends in a sync.
    void run(const Team& team) const {
        const Lanes lanes(team);
        for (int a = lanes.index; a < count; a += lanes.count) {
            group[a] = a;
            if (!small[a]) continue;
            for (int b = lanes.rank; b < count; b += lanes.size) touching[a * count + b] = 0;
        }
        team.sync();
        touch(team);
        team.sync();
        for (int a = lanes.index; a < count; a += lanes.count) {
            int most = 0;
            for (int b = lanes.rank; small[a] && b < count; b += lanes.size) {
                most = touching[a * count + b] > most ? touching[a * count + b] : most;
            }
            most = lanes.most(most);
            int partner = most ? count : a;
            for (int b = lanes.rank; most && b < partner; b += lanes.size) {
                if (touching[a * count + b] == most) partner = b;
            }
            joined[a] = lanes.least(partner);
        }
        team.sync();
        join(team);
    }

    // How many cells of small surfaces touch which surface, in the next cell or the one after it, at
    // all four sides.
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
                if (apart <= step && apart >= -step) team.add(touching + a * count + b, 1);
            };
            for (int away = 1; away <= REACH; ++away) {
                meet(c >= away, k - away);
                meet(c + away < columns, k + away);
                meet(row >= away, k - away * columns);
                meet(row + away < rows, k + away * columns);
            }
        }
    }

    // Connected components: labels fall to the smallest until none does. Ends in a sync.
    void join(const Team& team) const {
        for (bool open = true; team.any(open);) {
            for (int a = team.rank; a < count; a += team.size) {
                const int one = group[a], other = group[joined[a]];
                team.least(group + one, other);
                team.least(group + other, one);
                team.least(group + a, other);
                team.least(group + joined[a], one);
            }
            team.sync();
            open = false;
            for (int a = team.rank; a < count; a += team.size) {
                const int there = group[a], next = group[there];
                if (next < there) team.least(group + a, next);
                open |= next < there || there != group[joined[a]];
            }
        }
    }
};
