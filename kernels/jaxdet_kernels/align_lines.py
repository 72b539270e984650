"""Stage align on the CPU for lenses without distortion: a line of depth pixels at a time.

Twin of ``align_splat_rows``, operation by operation. The projection of a whole line has no branch,
so the compiler turns it into vector instructions; the hits are then written one pixel after the
other, without atomics, as Warp runs a CPU kernel's threads one by one.
"""

import warp as wp

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

MAX_WIDTH = 4096
"""Longest line of a depth image."""

_LINE = """
#if !defined(__CUDA_ARCH__)
    const int Hd = depth.shape[1], Wd = depth.shape[2];
    const int H = keys_out.shape[1], W = keys_out.shape[2];
    const wp::uint16* units = depth.data + ((size_t)b * Hd + v) * Wd;
    wp::uint32* image = keys_out.data + (size_t)b * H * W;
    const float* p = parameters.data;
    const float r0 = p[0], r1 = p[1], r2 = p[2], r3 = p[3], r4 = p[4], r5 = p[5], r6 = p[6];
    const float r7 = p[7], r8 = p[8], t0 = p[9], t1 = p[10], t2 = p[11];
    const float fx = p[12], fy = p[13], ppx = p[14], ppy = p[15], unit = p[25];
    int columns[2][4096], rows[2][4096];
    wp::uint32 key[4096];
    const int corners = fills ? 2 : 1;
    for (int corner = 0; corner < corners; ++corner) {
        const float* x = corner_x.data + corner;
        const float y = corner_y.data[(size_t)(v + corner) * (Wd + 1)];
        int* column = columns[corner];
        int* row = rows[corner];
        for (int u = 0; u < Wd; ++u) {
            const float z = (float)(int)units[u] * unit;
            const float px = z * x[u], py = z * y;
            const float cx = r0 * px + (r1 * py + (r2 * z + t0));
            const float cy = r3 * px + (r4 * py + (r5 * z + t1));
            const float cz = r6 * px + (r7 * py + (r8 * z + t2));
            const float ahead = cz > 0.0f ? cz : 1.0f;
            const float fu = (cx / ahead) * fx + ppx + 0.5f, fv = (cy / ahead) * fy + ppy + 0.5f;
            const bool seen = cz > 0.0f && fu < 1048576.0f && fu > -1048576.0f
                && fv < 1048576.0f && fv > -1048576.0f;
            // Out of sight: far below and to the right for corner 0, above and left for 1.
            const float away = corner ? -2.0f : 1048576.0f;
            column[u] = (int)(seen ? fu : away);
            row[u] = (int)(seen ? fv : away);
            if (corner == 0) {
                const float whole = ahead / unit + 0.5f;
                const float most = whole < 65534.0f ? whole : 65534.0f;
                key[u] = ((wp::uint32)units[u] << 16) | (wp::uint32)(int)most;
            }
        }
    }
    const int* right = columns[corners - 1];
    const int* bottom = rows[corners - 1];
    for (int u = 0; u < Wd; ++u) {
        if (units[u] == 0) continue;
        const int left = columns[0][u] > 0 ? columns[0][u] : 0;
        const int top = rows[0][u] > 0 ? rows[0][u] : 0;
        const int last_column = right[u] < W - 1 ? right[u] : W - 1;
        const int last_row = bottom[u] < H - 1 ? bottom[u] : H - 1;
        for (int i = top; i <= last_row; ++i) {
            wp::uint32* line = image + (size_t)i * W;
            for (int j = left; j <= last_column; ++j)
                line[j] = key[u] < line[j] ? key[u] : line[j];
        }
    }
#endif
"""


@wp.func_native(_LINE)
def _line(
    b: int,
    v: int,
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    fills: int,
    keys_out: wp.array3d[wp.uint32],
): ...


@wp.kernel
def align_splat_lines(
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    fills: int,
    keys_out: wp.array3d[wp.uint32],
):
    """A thread a depth row; for the CPU and separable corner rays."""
    b, v = wp.tid()
    _line(b, v, depth, corner_x, corner_y, parameters, fills, keys_out)
