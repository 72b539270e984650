"""Stage cluster on the CPU: a frame a thread, with one radix sort and union-find.

Twin of ``jaxdet/reference/_cluster.py``. Points are put in order of x once. In
that order a point needs to know only the last one before it in its slice, or in its set of
depths; which sets of depths there are is read off a map of the depths that occur.
"""

import warp as wp

from jaxdet_kernels.cluster_slices import SLICES

wp.set_module_options({"enable_backward": False})

_HEAD = """
    typedef unsigned long long u64;
    const int N = z.shape[1], most = 8192;
    const int* depths = z.data + (size_t)b * N;
    const int* sides = x.data + (size_t)b * N;
    const unsigned char* keep = (const unsigned char*)kept.data + (size_t)b * N;
    int* label = labels_out.data + (size_t)b * N;
    // The kept points in rising order of x, ties by slot: a radix sort of 10 and 9 bits.
    u64 point[most], point_2[most];  // x, z and slot in 19, 16 and 13 bits
    int low[1024], high[512], n = 0, nearest_z = 65535, farthest_z = 0;
    for (int i = 0; i < 1024; ++i) low[i] = 0;
    for (int i = 0; i < 512; ++i) high[i] = 0;
    for (int i = 0; i < N; ++i) {
        if (!keep[i]) continue;
        const unsigned key = sides[i] + (1 << 18) - 1;
        const int away = depths[i];
        point_2[n++] = (u64)key << 29 | (u64)away << 13 | i;
        ++low[key & 1023];
        ++high[key >> 10];
        nearest_z = away < nearest_z ? away : nearest_z;
        farthest_z = away > farthest_z ? away : farthest_z;
    }
    for (int i = 0, sum = 0, own; i < 1024; ++i) { own = low[i]; low[i] = sum; sum += own; }
    for (int i = 0, sum = 0, own; i < 512; ++i) { own = high[i]; high[i] = sum; sum += own; }
    for (int i = 0; i < n; ++i) point[low[point_2[i] >> 29 & 1023]++] = point_2[i];
    for (int i = 0; i < n; ++i) point_2[high[point[i] >> 39]++] = point[i];
    int side[most], depth[most], parent[most];
    unsigned short slot[most];
    for (int i = 0; i < n; ++i) {
        side[i] = (int)(point_2[i] >> 29);
        depth[i] = (int)(point_2[i] >> 13 & 65535);
        slot[i] = (unsigned short)(point_2[i] & 8191);
        parent[i] = i;
    }
    auto find = [&](int i) {
        while (parent[i] != i) i = parent[i] = parent[parent[i]];
        return i;
    };
    auto link = [&](int one, int two) {
        one = find(one);
        two = find(two);
        if (one < two) parent[two] = one;
        else parent[one] = two;
    };
    // By slice, and by depth; a frame may hold all depths.
    unsigned short last[2][65536];
"""

_GAPS = """
    // Which sets there are at first is a question of which depths there are.
    unsigned short* at = last[0];
    int size_by_z[most], end[most], open[most], sets = 0;
    for (int k = nearest_z; k <= farthest_z; ++k) at[k] = 0;
    for (int i = 0; i < n; ++i) ++at[depth[i]];
    for (int k = nearest_z, farthest = -1; k <= farthest_z; ++k) {
        if (!at[k]) continue;
        if (k > farthest) { size_by_z[sets] = 0; open[sets++] = -1; }
        size_by_z[sets - 1] += at[k];
        at[k] = sets - 1;
        farthest = k + depth_gap;
    }
    for (int i = 0; i < n; ++i) {
        const int s = at[depth[i]];
        if (size_by_z[s] <= min_points) continue;
        if (open[s] >= 0 && side[i] - end[s] <= lateral_gap) parent[i] = open[s];
        else open[s] = i;
        end[s] = side[i];
    }
"""

_NUMBER = """
    // A root is its set's first point in order of x. Number the large sets by nearest z, then
    // smallest x, then smallest slot.
    struct Set { int size, nearest, smallest, number; };
    Set sets_of[most];
    int large = 0;
    u64 keys[most];
    for (int i = 0; i < n; ++i) {
        int root = parent[i];
        if (root == i) {
            sets_of[i] = {1, depth[i], slot[i], -1};
            continue;
        }
        if (parent[root] != root) parent[i] = root = find(root);
        Set& own = sets_of[root];
        ++own.size;
        own.nearest = depth[i] < own.nearest ? depth[i] : own.nearest;
        own.smallest = slot[i] < own.smallest ? slot[i] : own.smallest;
    }
    for (int i = 0; i < n; ++i)
        if (parent[i] == i && sets_of[i].size > min_points)
            keys[large++] = (u64)sets_of[i].nearest << 45 | (u64)side[i] << 26
                | (u64)sets_of[i].smallest << 13 | i;
    for (int step = large / 2; step > 0; step = step == 2 ? 1 : step * 5 / 11)
        for (int i = step; i < large; ++i) {
            const u64 key = keys[i];
            int j = i;
            for (; j >= step && keys[j - step] > key; j -= step) keys[j] = keys[j - step];
            keys[j] = key;
        }
    for (int k = 0; k < large; ++k) sets_of[keys[k] & 8191].number = k;
    for (int i = 0; i < N; ++i) label[i] = -1;
    for (int i = 0; i < n; ++i) label[slot[i]] = sets_of[parent[i]].number;
    count_out.data[b] = large;
"""


@wp.func_native(f"{_HEAD}if (slice_units) {{{SLICES}}} else {{{_GAPS}}}{_NUMBER}")
def _cluster(
    b: int,
    x: wp.array2d[wp.int32],
    y: wp.array2d[wp.int32],
    z: wp.array2d[wp.int32],
    kept: wp.array2d[wp.bool],
    v: wp.array2d[wp.int32],
    gaps: wp.array[wp.int32],
    depth_gap: int,
    lateral_gap: int,
    min_points: int,
    slice_units: int,
    pixels: int,
    reach: int,
    slope: int,
    max_holes: int,
    tall_units: int,
    first_grid: int,
    labels_out: wp.array2d[wp.int32],
    count_out: wp.array[wp.int32],
): ...


@wp.kernel
def cluster_frames(
    share: int,
    shares: int,
    x: wp.array2d[wp.int32],
    y: wp.array2d[wp.int32],
    z: wp.array2d[wp.int32],
    kept: wp.array2d[wp.bool],
    v: wp.array2d[wp.int32],
    gaps: wp.array[wp.int32],
    depth_gap: int,
    lateral_gap: int,
    min_points: int,
    slice_units: int,
    pixels: int,
    reach: int,
    slope: int,
    max_holes: int,
    tall_units: int,
    first_grid: int,
    labels_out: wp.array2d[wp.int32],
    count_out: wp.array[wp.int32],
):
    """The labels of a frame a thread, ``(B, N)``, N at most 8192.

    Args:
        share: Which frames: thread i works on ``share + shares * i``.
        shares: Of how many shares.
        x: Sideways [depth units].
        y: Down in the camera [depth units].
        z: Forward [depth units], 0 = none.
        kept: The points that take part.
        v: Rows of the image, for the grid's rows.
        gaps: The largest step in depth within a surface, by depth.
        depth_gap: The largest step in depth within an obstacle [depth units].
        lateral_gap: The largest step sideways [depth units].
        min_points: Sets of this many points or fewer are dropped.
        slice_units: Depth of a slice [depth units], at most 2^18; 0: no slices, but all depths and
            then sideways, once.
        pixels: So far to the left in its row is looked for what goes on behind nearer things.
        reach: How far apart surfaces behind nearer things may be [depth units]; 0: not linked.
        slope: By how much the step in depth grows for each unit between them, in 1/1024, at most
            2048.
        max_holes: Pixels without depth between them.
        tall_units: Surfaces at least so high stand on their own [depth units]; 0: none does.
        first_grid: The slot of the grid's first pixel.
        labels_out: ``(B, N)``, -1 = no obstacle.
        count_out: ``(B,)``, how many obstacles.
    """
    _cluster(
        share + shares * wp.tid(), x, y, z, kept, v, gaps, depth_gap, lateral_gap, min_points,
        slice_units, pixels, reach, slope, max_holes, tall_units, first_grid, labels_out, count_out,
    )  # fmt: skip
