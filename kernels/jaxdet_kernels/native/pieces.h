// Surfaces too small to be an obstacle join the one they touch most.
// Twin of `whole_surfaces` in jaxdet/reference/_obstacles.py.
#pragma once
#include "lanes.h"
#include "numbering.h"

struct Pieces {
    enum { REACH = 2, AHEAD = 4 };
    int count, rows, columns, step;
    const int *label, *z;
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

    void meet(const Team& team, int a, int b, int step_in_z) const {
        if (b < 0 || step_in_z > step || step_in_z < -step) return;
        if (small[a]) team.add(touching + a * count + b, 1);
        if (small[b]) team.add(touching + b * count + a, 1);
    }

    void differ(const Team& team, int here, int there, const int* depth, int away) const {
        if (there >= 0 && there != here && (small[here] || small[there])) {
            meet(team, here, there, depth[away] - depth[0]);
        }
    }

    // How many cells of small surfaces touch which surface, in the next cell or the one after it.
    void touch(const Team& team) const {
#if defined(__CUDA_ARCH__)
        // Down the columns, AHEAD cells at a time: their loads wait together.
        for (int c = team.rank; c < columns; c += team.size) {
            const int one = c + 1 < columns ? 1 : 0, two = c + 2 < columns ? 2 : 0;
            for (int row = 0; row < rows; row += AHEAD) {
                int below[AHEAD + REACH], beside[AHEAD], next[AHEAD];
                for (int k = 0; k < AHEAD + REACH; ++k) {
                    below[k] = row + k < rows ? label[(row + k) * columns + c] : -1;
                }
                for (int k = 0; k < AHEAD; ++k) {
                    const int i = (row + k < rows ? row + k : row) * columns + c;
                    beside[k] = label[i + one];
                    next[k] = label[i + two];
                }
                for (int k = 0; k < AHEAD; ++k) {
                    const int here = below[k];
                    if (here < 0) continue;
                    const int* depth = z + (row + k) * columns + c;
                    differ(team, here, beside[k], depth, one);
                    differ(team, here, below[k + 1], depth, columns);
                    differ(team, here, next[k], depth, two);
                    differ(team, here, below[k + 2], depth, 2 * columns);
                }
            }
        }
#else
        for (int row = 0; row < rows; ++row) {
            const int* own = label + row * columns;
            const int* depth = z + row * columns;
            for (int c = team.rank; c < columns; c += team.size) {
                const int l = own[c];
                if (l < 0) continue;
                for (int away = 1; away <= REACH; ++away) {
                    const int down = away * columns;
                    if (c + away < columns && own[c + away] != l) {
                        meet(team, l, own[c + away], depth[c + away] - depth[c]);
                    }
                    if (row + away < rows && own[c + down] != l) {
                        meet(team, l, own[c + down], depth[c + down] - depth[c]);
                    }
                }
            }
        }
#endif
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
