"""Stage footprint on the CPU: a frame a thread, obstacle by obstacle.

Twin of ``jaxdet/reference/_footprint.py``.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

_BODY = """
    const int n = labels.shape[1], m = count_out.shape[1], most = 8192, far = (1 << 18) - 1;
    const size_t at = (size_t)b * n, slot = (size_t)b * m;
    const int* own = labels.data + at;
    const int* axis = axes.data + (size_t)b * 6;
    int right[most], forward[most], order[most], starts[most + 2], sorted[most];
    // Points by obstacle; the counts first.
    for (int k = 0; k < m + 2; ++k) starts[k] = 0;
    for (int i = 0; i < n; ++i)
        if (own[i] >= 0 && own[i] < m) ++starts[own[i] + 2];
    for (int k = 2; k < m + 2; ++k) starts[k] += starts[k - 1];
    for (int i = 0; i < n; ++i)
        if (own[i] >= 0 && own[i] < m) order[starts[own[i] + 1]++] = i;
    auto clip = [&](long long sum) {
        const int value = (int)((sum + (1 << 12)) >> 13);
        return value < -far ? -far : value > far ? far : value;
    };
    for (int k = 0; k < starts[m]; ++k) {
        const long long px = x.data[at + order[k]], py = y.data[at + order[k]];
        const long long pz = z.data[at + order[k]];
        right[k] = clip(px * axis[0] + py * axis[1] + pz * axis[2]);
        forward[k] = clip(px * axis[3] + py * axis[4] + pz * axis[5]);
    }
    for (int k = 0; k < m; ++k) {
        const int first = starts[k], end = starts[k + 1], count = end - first;
        int* uv[2] = {uv_min_out.data + (slot + k) * 2, uv_max_out.data + (slot + k) * 2};
        int* xyz[2] = {xyz_min_out.data + (slot + k) * 3, xyz_max_out.data + (slot + k) * 3};
        int* sum = xyz_sum_out.data + (slot + k) * 3;
        int* a = a_out.data + (slot + k) * 2;
        int* b = b_out.data + (slot + k) * 2;
        int* c = c_out.data + (slot + k) * 2;
        int* direction = direction_out.data + (slot + k) * 2;
        int* span = span_out.data + (slot + k) * 4;
        count_out.data[slot + k] = count;
        vertex_out.data[slot + k] = false;
        for (int j = 0; j < 2; ++j) {
            uv[0][j] = uv[1][j] = a[j] = b[j] = c[j] = direction[j] = 0;
            span[j] = span[j + 2] = 0;
        }
        for (int j = 0; j < 3; ++j) xyz[0][j] = xyz[1][j] = sum[j] = 0;
        if (count == 0) continue;
        auto widen = [&](int* low, int* high, int value, bool start) {
            if (start || value < *low) *low = value;
            if (start || value > *high) *high = value;
        };
        for (int i = first; i < end; ++i) {
            const size_t p = at + order[i];
            const int point[3] = {x.data[p], y.data[p], z.data[p]};
            widen(&uv[0][0], &uv[1][0], u.data[p], i == first);
            widen(&uv[0][1], &uv[1][1], v.data[p], i == first);
            for (int j = 0; j < 3; ++j) {
                widen(&xyz[0][j], &xyz[1][j], point[j], i == first);
                sum[j] += point[j];
            }
        }
        const int passed = trim < count / trim_share ? trim : count / trim_share;
        // Hoare's FIND: the value at a place in the rising order of those sorted so far.
        auto value_at = [&](int length, int place) {
            for (int low = 0, high = length - 1; low < high;) {
                const int pivot = sorted[place];
                int i = low, j = high;
                while (i <= j) {
                    while (sorted[i] < pivot) ++i;
                    while (pivot < sorted[j]) --j;
                    if (i > j) break;
                    const int value = sorted[i];
                    sorted[i++] = sorted[j];
                    sorted[j--] = value;
                }
                if (j < place) low = i;
                if (place < i) high = j;
            }
            return sorted[place];
        };
        // The median of the band above the smallest value, or with sign -1 below the largest.
        auto outermost = [&](const int* values, int sign, int band) {
            int length = 0;
            for (int i = first; i < end; ++i) {
                const int value = sign * values[i];
                if (length == passed + 1 && value >= sorted[passed]) continue;
                int j = length <= passed ? length++ : passed;
                for (; j > 0 && sorted[j - 1] > value; --j) sorted[j] = sorted[j - 1];
                sorted[j] = value;
            }
            // Those passed over come first in the order.
            const int limit = sorted[passed] + band;
            length = 0;
            for (int i = first; i < end; ++i)
                if (sign * values[i] <= limit) sorted[length++] = sign * values[i];
            return sign * value_at(length, (passed + length - 1) / 2);
        };
        auto least = [&](const int* values, const int* of, int best) {
            int found = far;
            for (int i = first; i < end; ++i)
                if (of[i] == best && values[i] < found) found = values[i];
            return found;
        };
        int nearest = far;
        for (int i = first; i < end; ++i) nearest = forward[i] < nearest ? forward[i] : nearest;
        const int* band = bands.data + 2 * (nearest < 0 ? 0 : nearest > 65535 ? 65535 : nearest);
        a[0] = outermost(right, 1, band[0]);
        b[0] = outermost(right, -1, band[0]);
        c[1] = outermost(forward, 1, band[1]);
        a[1] = least(forward, right, a[0]);
        b[1] = least(forward, right, b[0]);
        c[0] = least(right, forward, c[1]);
        vertex_out.data[slot + k] = (a[1] < b[1] ? a[1] : b[1]) - c[1] >= threshold;
        int dx = b[0] - a[0], dy = b[1] - a[1];
        const int wide = dx < 0 ? -dx : dx, deep = dy < 0 ? -dy : dy;
        for (int size = wide > deep ? wide : deep; size >= 512; size >>= 1) {
            dx >>= 1;
            dy >>= 1;
        }
        if (dx == 0 && dy == 0) dx = 1;
        direction[0] = dx;
        direction[1] = dy;
        for (int i = first; i < end; ++i) {
            widen(&span[0], &span[1], right[i] * dx + forward[i] * dy, i == first);
            widen(&span[2], &span[3], forward[i] * dx - right[i] * dy, i == first);
        }
    }
"""


@wp.func_native(_BODY)
def _footprint(
    b: int,
    labels: wp.array2d[wp.int32],
    u: wp.array2d[wp.int32],
    v: wp.array2d[wp.int32],
    x: wp.array2d[wp.int32],
    y: wp.array2d[wp.int32],
    z: wp.array2d[wp.int32],
    axes: wp.array3d[wp.int32],
    bands: wp.array2d[wp.int32],
    threshold: int,
    trim: int,
    trim_share: int,
    count_out: wp.array2d[wp.int32],
    uv_min_out: wp.array3d[wp.int32],
    uv_max_out: wp.array3d[wp.int32],
    xyz_min_out: wp.array3d[wp.int32],
    xyz_max_out: wp.array3d[wp.int32],
    xyz_sum_out: wp.array3d[wp.int32],
    a_out: wp.array3d[wp.int32],
    b_out: wp.array3d[wp.int32],
    c_out: wp.array3d[wp.int32],
    vertex_out: wp.array2d[wp.bool],
    direction_out: wp.array3d[wp.int32],
    span_out: wp.array3d[wp.int32],
): ...


@wp.kernel
def footprint_frames(
    share: int,
    shares: int,
    labels: wp.array2d[wp.int32],
    u: wp.array2d[wp.int32],
    v: wp.array2d[wp.int32],
    x: wp.array2d[wp.int32],
    y: wp.array2d[wp.int32],
    z: wp.array2d[wp.int32],
    axes: wp.array3d[wp.int32],
    bands: wp.array2d[wp.int32],
    threshold: int,
    trim: int,
    trim_share: int,
    count_out: wp.array2d[wp.int32],
    uv_min_out: wp.array3d[wp.int32],
    uv_max_out: wp.array3d[wp.int32],
    xyz_min_out: wp.array3d[wp.int32],
    xyz_max_out: wp.array3d[wp.int32],
    xyz_sum_out: wp.array3d[wp.int32],
    a_out: wp.array3d[wp.int32],
    b_out: wp.array3d[wp.int32],
    c_out: wp.array3d[wp.int32],
    vertex_out: wp.array2d[wp.bool],
    direction_out: wp.array3d[wp.int32],
    span_out: wp.array3d[wp.int32],
):
    """The obstacles of a frame a thread, N at most 8192; the outputs are the fields in order.

    Thread i works on frame ``share + shares * i``.
    """
    _footprint(
        share + shares * wp.tid(), labels, u, v, x, y, z, axes, bands, threshold, trim, trim_share,
        count_out, uv_min_out, uv_max_out, xyz_min_out, xyz_max_out, xyz_sum_out,
        a_out, b_out, c_out, vertex_out, direction_out, span_out,
    )  # fmt: skip
