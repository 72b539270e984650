"""Stage align on the CPU for lenses without distortion: a line of depth pixels at a time.

Twin of ``align_splat_rows``, operation by operation. The projection of a whole line has no branch,
so the compiler turns it into vector instructions. Depth pixels that cover the same colour rows
lower a line of keys in common, one pixel after the other; the line then lowers all of those rows,
again in vectors. No atomics: a frame belongs to one thread.
"""

import warp as wp

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

MAX_SIZE = 4096
"""Most columns of a depth image, and most columns and rows of a colour image."""

_PROJECT = """
    const int Hd = depth.shape[1], Wd = depth.shape[2];
    const int H = depth_out.shape[1], W = depth_out.shape[2];
    wp::uint32* image = keys_out.data + (size_t)share * H * W;
    const float* p = parameters.data;
    const float r0 = p[0], r1 = p[1], r2 = p[2], r3 = p[3], r4 = p[4], r5 = p[5], r6 = p[6];
    const float r7 = p[7], r8 = p[8], t0 = p[9], t1 = p[10], t2 = p[11];
    const float fx = p[12], fy = p[13], ppx = p[14], ppy = p[15], unit = p[25];
    const wp::uint32 none = 0xFFFFFFFFu;
    // Of each depth pixel: its key, the colour columns and rows; rows -1: out of sight.
    int lefts[4096], rights[4096], spans[4096];
    wp::uint32 keys[4096];
    auto project_line = [&](int v) {
        const wp::uint16* units = depth.data + ((size_t)b * Hd + v) * Wd;
        auto project = [&](int u, int corner, int& column, int& row, float& z) {
            const float away = (float)(int)units[u] * unit;
            const float px = away * corner_x.data[u + corner];
            const float py = away * corner_y.data[(size_t)(v + corner) * (Wd + 1)];
            const float cx = r0 * px + (r1 * py + (r2 * away + t0));
            const float cy = r3 * px + (r4 * py + (r5 * away + t1));
            const float cz = r6 * px + (r7 * py + (r8 * away + t2));
            z = cz > 0.0f ? cz : 1.0f;
            const float fu = (cx / z) * fx + ppx + 0.5f, fv = (cy / z) * fy + ppy + 0.5f;
            const bool fits = cz > 0.0f && fu < 1048576.0f && fu > -1048576.0f
                && fv < 1048576.0f && fv > -1048576.0f;
            column = (int)(fits ? fu : 0.0f);
            row = (int)(fits ? fv : 0.0f);
            return fits;
        };
        for (int u = 0; u < Wd; ++u) {
            int left, right, top, bottom;
            float z, other_z;
            bool seen = units[u] != 0;
            seen &= project(u, 0, left, top, z);
            seen &= project(u, fills, right, bottom, other_z);
            const float whole = z / unit + 0.5f;
            const float most = whole < 65534.0f ? whole : 65534.0f;
            keys[u] = (wp::uint32)units[u] << 16 | (wp::uint32)(int)most;
            left = left > 0 ? left : 0;
            top = top > 0 ? top : 0;
            right = right < W - 1 ? right : W - 1;
            bottom = bottom < H - 1 ? bottom : H - 1;
            seen &= (left <= right) & (top <= bottom);
            lefts[u] = left;
            rights[u] = right;
            spans[u] = seen ? top << 16 | bottom : -1;
        }
    };
"""

_SPLAT = """
    // Where a row's end flickers between two, both of its lines stay in use.
    wp::uint32 lines[4][4096];
    int span_of[4], first[4], last[4];
    for (int k = 0; k < 4; ++k) {
        span_of[k] = -1;
        first[k] = W;
        last[k] = -1;
        for (int j = 0; j < W; ++j) lines[k][j] = none;
    }
    auto lower_rows = [&](int k) {
        wp::uint32* line = lines[k];
        const int from = first[k], to = last[k];
        for (int i = span_of[k] >> 16; i <= (span_of[k] & 0xFFFF) && from <= to; ++i) {
            wp::uint32* row = image + (size_t)i * W;
            for (int j = from; j <= to; ++j) row[j] = line[j] < row[j] ? line[j] : row[j];
        }
        for (int j = from; j <= to; ++j) line[j] = none;
        first[k] = W;
        last[k] = -1;
    };
    for (size_t i = 0; i < (size_t)H * W; ++i) image[i] = none;
    for (int v = 0; v < Hd; ++v) {
        project_line(v);
        for (int u = 0; u < Wd; ++u) {
            const int span = spans[u];
            if (span < 0) continue;
            const int k = (span >> 15 & 2) | (span & 1);
            if (span != span_of[k]) {
                lower_rows(k);
                span_of[k] = span;
            }
            const int left = lefts[u], right = rights[u];
            const wp::uint32 key = keys[u];
            first[k] = left < first[k] ? left : first[k];
            last[k] = right > last[k] ? right : last[k];
            wp::uint32* line = lines[k];
            for (int j = left; j <= right; ++j) line[j] = key < line[j] ? key : line[j];
        }
    }
    for (int k = 0; k < 4; ++k) lower_rows(k);
    wp::uint16* found = depth_out.data + (size_t)b * H * W;
    wp::uint16* found_z = z_out.data + (size_t)b * H * W;
    for (size_t i = 0; i < (size_t)H * W; ++i) {
        const wp::uint32 key = image[i] == none ? 0 : image[i];
        found[i] = (wp::uint16)(key >> 16);
        found_z[i] = (wp::uint16)key;
    }
"""


@wp.func_native(f"#if !defined(__CUDA_ARCH__)\n{_PROJECT}{_SPLAT}#endif\n")
def _frame(
    b: int,
    share: int,
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    fills: int,
    depth_out: wp.array3d[wp.uint16],
    z_out: wp.array3d[wp.uint16],
    keys_out: wp.array3d[wp.uint32],
): ...


@wp.kernel
def align_lines(
    share: int,
    shares: int,
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    fills: int,
    depth_out: wp.array3d[wp.uint16],
    z_out: wp.array3d[wp.uint16],
    keys_out: wp.array3d[wp.uint32],
):
    """A thread a frame, ``share + shares * i``; for the CPU and separable corner rays.

    The outputs are ``(B, H, W)``, 0 where nothing hits; ``keys_out`` ``(shares, H, W)`` is scratch.
    """
    b = share + shares * wp.tid()
    _frame(
        b, share, depth, corner_x, corner_y, parameters, fills, depth_out, z_out, keys_out
    )  # fmt: skip
