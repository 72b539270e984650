"""Sets of linked points on the CPU, slice by slice and along surfaces; part of a kernel.

Twin of ``jaxdet/reference/_slices.py``, from the points in order of x that ``cluster_frames`` has.
Surfaces come first. Where at most one of them is tall, the links sideways are simply joined.
"""

SLICES = """
    // A slice's number by a product: exact for depths below 2^17 and slices up to 2^18.
    const u64 inverse = (1ull << 40) / slice_units + 1;
    auto slice = [&](int at) { return (int)((u64)at * inverse >> 40); };
    const int start[2] = {0, slice_units / 2};
    int first[2];
    for (int cut = 0; cut < 2; ++cut) {
        first[cut] = slice(nearest_z + start[cut]);
        const int slices = slice(farthest_z + start[cut]) - first[cut] + 1;
        for (int k = 0; k < slices; ++k) last[cut][k] = 65535;
    }
    const int* row = v.data + (size_t)b * N;
    const int* down = y.data + (size_t)b * N;
    unsigned short place[most];
    for (int i = 0; i < n; ++i) place[slot[i]] = i;
    for (int i = first_grid; i < N && reach; ++i) {
        if (!keep[i]) continue;
        int holes = 0;
        for (int j = i - 1; j >= first_grid && j >= i - pixels && row[j] == row[i]; --j) {
            if (keep[j]) {
                int aside = sides[i] - sides[j];
                aside = aside < 0 ? -aside : aside;
                const int gap = depth_gap + (slope * aside >> 10);
                if (depths[j] < depths[i] - gap) continue;
                if (depths[j] <= depths[i] + gap && aside <= reach && j < i - 1)
                    link(place[j], place[i]);
                break;
            }
            if (depths[j] > 0 || ++holes > max_holes) break;
        }
    }
    // The neighbour in its slice of a cut; points are asked for in order of x. 65535: none.
    auto to_the_left = [&](int i, int cut) -> int {
        unsigned short& before = last[cut][slice(depth[i] + start[cut]) - first[cut]];
        const int left = before;
        before = i;
        return left != 65535 && side[i] - side[left] <= lateral_gap ? left : 65535;
    };
    int tall = 0;
    if (tall_units) {
        int columns = 1;
        while (first_grid + columns < N && row[first_grid + columns] == row[first_grid]) ++columns;
        auto neighbours = [&](int i, int j) {
            if (!keep[i] || !keep[j]) return;
            const int nearer = depths[i] < depths[j] ? depths[i] : depths[j];
            const int step = depths[i] - depths[j];
            if (step <= gaps.data[nearer] && -step <= gaps.data[nearer]) link(place[i], place[j]);
        };
        for (int i = first_grid + 1; i < N; ++i) {
            if (row[i] == row[i - 1]) neighbours(i, i - 1);
            if (i >= first_grid + columns) neighbours(i, i - columns);
        }
    }
    // Whose each surface is, by its root: how many links away, and the owner's smallest slot.
    const int nobody = 1 << 30;
    int owner[most], top[most], bottom[most];
    unsigned short surface[most];
    if (tall_units) {
        for (int i = 0; i < n; ++i) {
            surface[i] = find(i);
            owner[i] = slot[i];
            top[i] = 1 << 20;
            bottom[i] = -(1 << 20);
        }
        for (int i = 0; i < n; ++i) {
            const int s = surface[i], at = down[slot[i]];
            owner[s] = slot[i] < owner[s] ? slot[i] : owner[s];
            if (slot[i] < first_grid) continue;
            top[s] = at < top[s] ? at : top[s];
            bottom[s] = at > bottom[s] ? at : bottom[s];
        }
        for (int i = 0; i < n; ++i) {
            const bool stands = surface[i] == i && bottom[i] - top[i] >= tall_units;
            tall += stands;
            if (!stands) owner[i] = nobody;
        }
    }
    if (tall < 2) {
        for (int i = 0; i < n; ++i) {
            int root = find(i);
            for (int cut = 0; cut < 2; ++cut) {
                const int left = to_the_left(i, cut);
                if (left == 65535) continue;
                const int other = find(left), after = other > root ? other : root;
                root = other < root ? other : root;
                parent[after] = root;
            }
        }
    } else {
        int ends[2 * most][2], links = 0;
        for (int i = 0; i < n; ++i)
            for (int cut = 0; cut < 2; ++cut) {
                const int left = to_the_left(i, cut);
                if (left == 65535) continue;
                const int one = surface[i], two = surface[left];
                if (one == two || (owner[one] != nobody && owner[two] != nobody)) continue;
                ends[links][0] = one;
                ends[links++][1] = two;
            }
        // A link has told all it can once one of its ends was given away in an earlier round.
        for (int round = 1, more = 1; more; ++round) {
            int left = 0;
            more = 0;
            for (int k = 0; k < links; ++k) {
                bool told = false;
                for (int way = 0; way < 2; ++way) {
                    const int from = owner[ends[k][way]];
                    if (from >> 13 >= round) continue;
                    int& to = owner[ends[k][1 - way]];
                    const int offer = round << 13 | (from & 8191);
                    if (to > offer) { to = offer; more = 1; }
                    told = true;
                }
                if (told) continue;
                ends[left][0] = ends[k][0];
                ends[left++][1] = ends[k][1];
            }
            links = left;
        }
        for (int k = 0; k < links; ++k) link(ends[k][0], ends[k][1]);
        for (int i = 0; i < n; ++i)
            if (surface[i] == i && owner[i] != nobody) link(place[owner[i] & 8191], i);
    }
"""
"""Joins ``parent`` of each point."""
