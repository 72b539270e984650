"""Stage cluster on the CPU: a frame a thread, with counting sorts and union-find.

Twin of ``jaxdet/reference/_cluster.py`` and ``_slices.py``. Points are put in order of x and of z
once; everything after that is a walk along one of these orders.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

MAX_POINTS = 8192
"""Points of a frame."""

_HEAD = """
    typedef unsigned long long u64;
    const int n = z.shape[1], most = 8192;
    const int* side = x.data + (size_t)b * n;
    const int* depth = z.data + (size_t)b * n;
    const unsigned char* keep = (const unsigned char*)kept.data + (size_t)b * n;
    int* label = labels_out.data + (size_t)b * n;
    int points[most], by_z[most], by_x[most], swap[most], bins[1025], set[most];
    int count = 0;
    for (int i = 0; i < n; ++i)
        if (keep[i]) points[count++] = i;
    // The points in rising order of 20-bit keys, ties by slot.
    auto order = [&](int* out, auto key) {
        const int* from = points;
        for (int shift = 0; shift < 20; shift += 10) {
            int* to = shift ? out : swap;
            for (int i = 0; i < 1025; ++i) bins[i] = 0;
            for (int i = 0; i < count; ++i) ++bins[(key(from[i]) >> shift & 1023) + 1];
            for (int i = 1; i < 1024; ++i) bins[i] += bins[i - 1];
            for (int i = 0; i < count; ++i) to[bins[key(from[i]) >> shift & 1023]++] = from[i];
            from = swap;
        }
    };
    order(by_x, [&](int i) { return side[i] + (1 << 18); });
"""

_SLICES = """
    short last[65536];  // the last point of each slice
    int* parent = set;
    auto find = [&](int i) {
        while (parent[i] != i) i = parent[i] = parent[parent[i]];
        return i;
    };
    // A root is the smallest slot of its set.
    auto link = [&](int one, int two) {
        one = find(one);
        two = find(two);
        if (one < two) parent[two] = one;
        else parent[one] = two;
    };
    for (int i = 0; i < n; ++i) parent[i] = i;
    for (int cut = 0; cut < 2; ++cut) {
        auto slice = [&](int i) { return (depth[i] + (cut ? slice_units / 2 : 0)) / slice_units; };
        for (int k = 0; k < count; ++k) last[slice(points[k])] = -1;
        for (int k = 0; k < count; ++k) {
            const int i = by_x[k], at = slice(i), left = last[at];
            if (left >= 0 && side[i] - side[left] <= lateral_gap) link(left, i);
            last[at] = (short)i;
        }
    }
    const int* row = v.data + (size_t)b * n;
    const int* seen = camera_z.data + (size_t)b * n;
    for (int i = first_grid; i < n && reach; ++i) {
        if (!keep[i]) continue;
        const int gap = gaps.data[depth[i]];
        int holes = 0;
        for (int j = i - 1; j >= first_grid && j >= i - 16 && row[j] == row[i]; --j) {
            if (keep[j]) {
                if (depth[j] < depth[i] - gap) continue;
                const int aside = side[i] - side[j];
                if (depth[j] <= depth[i] + gap && aside <= reach && -aside <= reach) link(j, i);
                break;
            }
            if (seen[j] > 0 || ++holes > max_holes) break;
        }
    }
    for (int k = 0; k < count; ++k) set[points[k]] = find(points[k]);
"""

_GAPS = """
    order(by_z, [&](int i) { return depth[i]; });
    for (int k = 0; k < count; ++k) set[points[k]] = 0;
    int sets = 1, starts[most + 2], by_set[most];
    // Splits each set at the gaps along one of the orders; small parts are dropped, set = n.
    auto split = [&](const int* along, const int* value, auto gap_at) {
        for (int s = 0; s <= sets; ++s) starts[s] = 0;
        for (int k = 0; k < count; ++k)
            if (set[points[k]] < n) ++starts[set[points[k]] + 1];
        for (int s = 0; s < sets; ++s) starts[s + 1] += starts[s];
        const int total = starts[sets];
        for (int k = 0; k < count; ++k)
            if (set[along[k]] < n) swap[starts[set[along[k]]]++] = along[k];
        int found = 0;
        for (int first = 0, end; first < total; first = end) {
            const int own = set[swap[first]];
            for (end = first + 1; end < total && set[swap[end]] == own
                 && value[swap[end]] - value[swap[end - 1]] <= gap_at(swap[end - 1]); ++end) {}
            const int now = end - first > min_points ? found++ : n;
            for (int k = first; k < end; ++k) by_set[k] = now;
        }
        for (int k = 0; k < total; ++k) set[swap[k]] = by_set[k];
        sets = found;
    };
    for (int round = 0; round < rounds; ++round) {
        split(by_z, depth, [&](int i) { return gaps.data[depth[i]]; });
        split(by_x, side, [&](int) { return lateral_gap; });
    }
"""

_NUMBER = """
    // Number the large sets by nearest z, then smallest x, then their own numbers.
    int size[most], nearest[most], leftmost[most];
    u64 keys[most];
    for (int i = 0; i < n; ++i) size[i] = 0;
    for (int k = 0; k < count; ++k) {
        const int i = points[k], s = set[i];
        if (s == n) continue;
        nearest[s] = size[s] && nearest[s] < depth[i] ? nearest[s] : depth[i];
        leftmost[s] = size[s] && leftmost[s] < side[i] ? leftmost[s] : side[i];
        ++size[s];
    }
    int large = 0;
    for (int s = 0; s < n; ++s)
        if (size[s] > min_points)
            keys[large++] = (u64)nearest[s] << 40 | (u64)(leftmost[s] + (1 << 18)) << 16 | s;
    for (int step = large / 2; step > 0; step = step == 2 ? 1 : step * 5 / 11)
        for (int i = step; i < large; ++i) {
            const u64 key = keys[i];
            int j = i;
            for (; j >= step && keys[j - step] > key; j -= step) keys[j] = keys[j - step];
            keys[j] = key;
        }
    for (int s = 0; s < n; ++s) nearest[s] = -1;
    for (int k = 0; k < large; ++k) nearest[(int)(keys[k] & 0xffff)] = k;
    for (int i = 0; i < n; ++i) label[i] = keep[i] && set[i] < n ? nearest[set[i]] : -1;
    count_out.data[b] = large;
"""


@wp.func_native(f"{_HEAD}if (slice_units) {{{_SLICES}}} else {{{_GAPS}}}{_NUMBER}")
def _cluster(
    b: int,
    x: wp.array2d[wp.int32],
    z: wp.array2d[wp.int32],
    kept: wp.array2d[wp.bool],
    v: wp.array2d[wp.int32],
    camera_z: wp.array2d[wp.int32],
    gaps: wp.array[wp.int32],
    lateral_gap: int,
    min_points: int,
    rounds: int,
    slice_units: int,
    reach: int,
    max_holes: int,
    first_grid: int,
    labels_out: wp.array2d[wp.int32],
    count_out: wp.array[wp.int32],
): ...


@wp.kernel
def cluster_frames(
    x: wp.array2d[wp.int32],
    z: wp.array2d[wp.int32],
    kept: wp.array2d[wp.bool],
    v: wp.array2d[wp.int32],
    camera_z: wp.array2d[wp.int32],
    gaps: wp.array[wp.int32],
    lateral_gap: int,
    min_points: int,
    rounds: int,
    slice_units: int,
    reach: int,
    max_holes: int,
    first_grid: int,
    labels_out: wp.array2d[wp.int32],
    count_out: wp.array[wp.int32],
):
    """The labels of a frame a thread, ``(B, N)``, N at most ``MAX_POINTS``.

    Args:
        x: Sideways [depth units].
        z: Forward [depth units].
        kept: The points that take part.
        v: Rows of the image, for the grid's rows.
        camera_z: Depth in the camera, 0 = none.
        gaps: The largest step in depth, by depth.
        lateral_gap: The largest step sideways [depth units].
        min_points: Sets of this many points or fewer are dropped.
        rounds: Of splits, without slices.
        slice_units: Depth of a slice [depth units]; 0: no slices.
        reach: How far apart surfaces behind nearer things may be [depth units]; 0: not linked.
        max_holes: Pixels without depth between them.
        first_grid: The slot of the grid's first pixel.
        labels_out: ``(B, N)``, -1 = no obstacle.
        count_out: ``(B,)``, how many obstacles.
    """
    _cluster(
        wp.tid(), x, z, kept, v, camera_z, gaps, lateral_gap, min_points, rounds, slice_units,
        reach, max_holes, first_grid, labels_out, count_out,
    )  # fmt: skip
