"""Stages 1 to 3 on the CPU in one go: a frame a thread, depth looked up only where it is asked.

The edges of ``features_canny_lines``, the selection of ``features_select_lines`` and the depth of
``align_search``. Equal to align, ground and features one after the other, at every feature.
"""

import warp as wp

from jaxdet_kernels.align_ranges_lines import RANGES
from jaxdet_kernels.align_search import SEARCH
from jaxdet_kernels.features_canny_lines import canny_hysteresis_lines, canny_suppress_lines
from jaxdet_kernels.features_corners_lines import MEASURE, STRENGTH
from jaxdet_kernels.features_select_lines import SELECT

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

_ASK = """
    const int H = limits.shape[1], W = limits.shape[2], G = grid_u.shape[0];
    const int P = u_out.shape[1], N = P - G;
    const wp::uint32* edge_map = edges.data + (size_t)part * H * edges.shape[2];
    const unsigned short* limit = limits.data + (size_t)which.data[b] * H * W;
    const unsigned nearest_kept = bounds.data[0], farthest_kept = bounds.data[1];
    bool seen = false;
    auto in_range = [&](unsigned z) { return z >= nearest_kept && z <= farthest_kept; };
    // No depth pixel farther than this has that z at a pixel. The cameras' depths there differ by a
    // factor and an offset; within the pixels' footprints the factor varies by far less than 2 %
    // where the cameras look the same way, or else there is no bound.
    const bool parallel = SIZE(s[6]) + SIZE(s[7]) <= 0.05f
        && MOST(MOST(s[27], s[28]), MOST(s[29], s[30])) <= 0.025f;
    auto farthest_depth = [&](int x, int y, unsigned z) -> unsigned {
        const float kx = ((float)x - p[14]) * s[29], ky = ((float)y - p[15]) * s[30];
        const float units = 1.02f * ((float)(int)z + 1.0f) * (s[6] * kx + s[7] * ky + s[8])
            + SIZE(s[11]) + 2.0f;
        return parallel && z < 65534 && units < 65535.0f ? (unsigned)(int)units : 65535u;
    };
    auto depth_at = [&](int x, int y, unsigned cap = 65535) -> unsigned {
        if (aligned) return image[(size_t)y * W + x];
        const unsigned key = smallest_key(x, y, cap);
        return key == 0xffffffffu ? 0u : key & 0xffffu;
    };
    auto keeps = [&](unsigned z, int x, int y) {
        const bool in = in_range(z);
        seen |= in;
        return in && z <= limit[(size_t)y * W + x];
    };
    unsigned last = 0;
    auto expect = [&](int place) { __builtin_prefetch(limit + place); };
    auto allowed = [&](int x, int y) {
        if (!masked) return true;
        const unsigned own = limit[(size_t)y * W + x], z = LEAST(own, farthest_kept);
        if (z < nearest_kept) return false;
        last = depth_at(x, y, farthest_depth(x, y, z));
        return keeps(last, x, y);
    };
    auto put = [&](int slot, int x, int y, unsigned z, bool valid, bool kept) {
        const size_t at = (size_t)b * P + slot, pixel = (size_t)y * W + x;
        const long long half = 1 << (RAY_BITS - 1);
        u_out.data[at] = x;
        v_out.data[at] = y;
        x_out.data[at] = (int)((fixed_x.data[pixel] * (long long)z + half) >> RAY_BITS);
        y_out.data[at] = (int)((fixed_y.data[pixel] * (long long)z + half) >> RAY_BITS);
        z_out.data[at] = (int)z;
        valid_out.data[at] = valid;
        kept_out.data[at] = kept;
    };
    auto accept = [&](int slot, int x, int y) {
        const unsigned z = masked ? last : depth_at(x, y);
        put(slot, x, y, z, true, masked || keeps(z, x, y));
    };
""".replace("RAY_BITS", "20")

_FINISH = """
    found_out.data[b] = taken;
    for (int slot = taken; slot < N; ++slot) put(slot, 0, 0, 0, false, false);
    for (int i = 0; i < G; ++i) {
        const int x = grid_u.data[i], y = grid_v.data[i];
        if (i + 8 < G) expect(grid_v.data[i + 8] * W + grid_u.data[i + 8]);
        const unsigned z = depth_at(x, y);
        const bool kept = keeps(z, x, y);
        put(N + i, x, y, z, kept, kept);
    }
    // Only where no pixel asked for was in range: is there any? Depth pixels in range show where.
    const int rows = depth.shape[1], columns = depth.shape[2];
    for (int i = 0; i < rows && !seen; ++i) {
        const unsigned short* line = image + (size_t)i * columns;
        if (aligned) {
            for (int j = 0; j < columns; ++j) seen |= in_range(line[j]);
            continue;
        }
        auto moved = [&](int j) {
            const float z = moved_z(line[j], i, j) / p[25] + 0.5f;
            return line[j] ? (unsigned)(int)(z > 0.0f ? LEAST(z, 65534.0f) : 0.0f) : 0u;
        };
        bool any = false;
        for (int j = 0; j < columns; ++j) any |= in_range(moved(j));
        for (int j = 0; j < columns && any && !seen; ++j) {
            int left, top, right, bottom;
            if (!in_range(moved(j)) || !project(line[j], i, j, left, top)) continue;
            right = left;
            bottom = top;
            if (fills && !project(line[j], i + 1, j + 1, right, bottom)) continue;
            for (int y = MOST(top, 0); y <= LEAST(bottom, H - 1) && !seen; ++y)
                for (int x = MOST(left, 0); x <= LEAST(right, W - 1) && !seen; ++x)
                    seen = in_range(depth_at(x, y));
        }
    }
    seen_out.data[b] = seen;
"""

_BODY = "".join([RANGES, SEARCH, _ASK, STRENGTH, MEASURE, SELECT, _FINISH])


@wp.func_native(f"#if !defined(__CUDA_ARCH__)\n{_BODY}#endif\n")
def _features(
    b: int,
    part: int,
    edges: wp.array3d[wp.uint32],
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    search: wp.array[wp.float32],
    limits: wp.array3d[wp.uint16],
    which: wp.array[wp.int32],
    bounds: wp.array[wp.int32],
    fixed_x: wp.array2d[wp.int32],
    fixed_y: wp.array2d[wp.int32],
    grid_u: wp.array[wp.int32],
    grid_v: wp.array[wp.int32],
    aligned: int,
    fills: int,
    masked: int,
    quality: wp.float64,
    distance: wp.float64,
    strength: wp.array2d[wp.float32],
    u_out: wp.array2d[wp.int32],
    v_out: wp.array2d[wp.int32],
    x_out: wp.array2d[wp.int32],
    y_out: wp.array2d[wp.int32],
    z_out: wp.array2d[wp.int32],
    valid_out: wp.array2d[wp.bool],
    kept_out: wp.array2d[wp.bool],
    found_out: wp.array[wp.int32],
    seen_out: wp.array[wp.bool],
    tiles: wp.array3d[wp.uint32],
    ranges: wp.array[wp.uint32],
    keys_out: wp.array[wp.uint32],
    blocked_out: wp.array2d[wp.uint32],
): ...


@wp.kernel
def features_depth_lines(
    share: int,
    shares: int,
    color: wp.array4d[wp.uint8],
    low: int,
    high: int,
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    search: wp.array[wp.float32],
    limits: wp.array3d[wp.uint16],
    which: wp.array[wp.int32],
    bounds: wp.array[wp.int32],
    fixed_x: wp.array2d[wp.int32],
    fixed_y: wp.array2d[wp.int32],
    grid_u: wp.array[wp.int32],
    grid_v: wp.array[wp.int32],
    aligned: int,
    fills: int,
    masked: int,
    quality: wp.float64,
    distance: wp.float64,
    strength: wp.array3d[wp.float32],
    u_out: wp.array2d[wp.int32],
    v_out: wp.array2d[wp.int32],
    x_out: wp.array2d[wp.int32],
    y_out: wp.array2d[wp.int32],
    z_out: wp.array2d[wp.int32],
    valid_out: wp.array2d[wp.bool],
    kept_out: wp.array2d[wp.bool],
    found_out: wp.array[wp.int32],
    seen_out: wp.array[wp.bool],
    tiles_out: wp.array3d[wp.uint32],
    ranges_out: wp.array[wp.uint32],
    keys_out: wp.array2d[wp.uint32],
    blocked_out: wp.array3d[wp.uint32],
    weak_out: wp.array3d[wp.uint32],
    strong_out: wp.array3d[wp.uint32],
    edges_out: wp.array3d[wp.uint32],
):
    """The features of a frame a thread, ``share + shares * i``.

    ``strength`` and what follows ``ranges_out`` are scratch, a part for each share.
    """
    b = share + shares * wp.tid()
    canny_suppress_lines(b, color, low, high, weak_out[share], strong_out[share])
    canny_hysteresis_lines(share, weak_out[share], strong_out[share], edges_out)
    _features(
        b, share, edges_out, depth, corner_x, corner_y, parameters, search, limits, which, bounds,
        fixed_x, fixed_y, grid_u, grid_v, aligned, fills, masked, quality, distance,
        strength[share], u_out, v_out, x_out, y_out, z_out, valid_out, kept_out, found_out,
        seen_out, tiles_out, ranges_out, keys_out[share], blocked_out[share],
    )  # fmt: skip
