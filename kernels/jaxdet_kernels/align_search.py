"""The search for what the dense alignment puts at one colour pixel, as text for native functions.

Twin of ``align_splat`` for lenses without distortion. A colour pixel can be hit only by depth
pixels on a short stretch (the epipolar line between the nearest and the farthest depth there), so
each point walks along its stretch. Three tests, from coarse to fine:

1. The stretch. In the depth image the pixel's ray at inverse depth w is the straight path
   ``p(w) = p0 + w p1``; the depth pixels that can cover the colour pixel lie in a box around it,
   whose size the host bounds (``search``). The path is cut into pieces of about ``STEP`` pixels,
   nearest first; of each only the part is left that the depth range of its tiles allows.
2. Four signs. The corners ``(x0, y0)``, upper left, and ``(x1, y1)``, lower right, of a depth pixel
   at depth z have the projections f0, f1. It covers the pixel when ``f0 < u + 1`` and
   ``f1 >= u``, and so in rows. With ``k = (u + 1/2 - c_x) / f_x`` the first reads
   ``z ((r0 - k r6) x0 + (r1 - k r7) y0 + (r2 - k r8)) + (t0 - k t2) < 0``: two fused operations, as
   the bracket is linear in the pixel's column.
3. The arithmetic of the dense kernel, operation by operation, where a sign is not sure.

Margin of the second test, in units of ``2^-24 S``, S being the sum of the magnitudes of the terms
with the largest x, y and k: the dense arithmetic differs from real numbers by at most 8.2 in the
quotient, its product and sums, 4 in the moved point and 1 in z; the linear form by 8.2 (slope times
column), 8.1 (the constant), 3 + 3 + 1 (sums), 2.1 (the table of rays), 3.1 (k): below 42 in all.
The margin is ``64 = 2^-18 S``. A sign beyond it is the dense kernel's, provided that the point is
well in front of the colour camera: at ``search[24]`` units or more.
"""

TILE = 16
"""Side of the tiles of the depth image whose depth range is known [pixel]."""

SEARCH_VALUES = 34
"""Length of ``search``: inverse rotation 0-8 (rows 0 and 1 in depth pixels), origin 9-11 (the same,
by depth unit), first corner 12-13 [depth pixel], box in x 14-17 and y 18-21 (before, after, by
footprint, by inverse depth), margin 22-23 (by depth, constant), least sure depth 24, first corner
25-26 and steps 27-28 of the rays, 1 / fx 29, 1 / fy 30, translation 31-33 [depth units]."""

SEARCH = """
    #if defined(__CUDA_ARCH__)
    #define FUSED(a, b, c) __fmaf_rn(a, b, c)
    #else
    #define FUSED(a, b, c) ((a) * (b) + (c))
    #endif
    #define LEAST(a, b) ((a) < (b) ? (a) : (b))
    #define MOST(a, b) ((a) > (b) ? (a) : (b))
    #define SIZE(a) ((a) < 0.0f ? -(a) : (a))
    const int Hd = depth.shape[1], Wd = depth.shape[2], tiles_x = tiles.shape[2];
    const unsigned short* image = depth.data + (size_t)b * Hd * Wd;
    const unsigned* tile_ranges = tiles.data + (size_t)b * tiles.shape[1] * tiles_x;
    const unsigned frame_range = ranges.data[b];
    const float* p = parameters.data;
    const float* s = search.data;
    const float* ray_x = corner_x.data;
    const float* ray_y = corner_y.data;
    auto moved_z = [&](unsigned units, int i, int j) -> float {
        const float z = (float)(int)units * p[25];
        const float px = z * ray_x[j], py = z * ray_y[(size_t)i * (Wd + 1)];
        return p[6] * px + (p[7] * py + (p[8] * z + p[11]));
    };
    auto project = [&](unsigned units, int i, int j, int& column, int& row) -> bool {
        const float z = (float)(int)units * p[25];
        const float px = z * ray_x[j], py = z * ray_y[(size_t)i * (Wd + 1)];
        const float cx = p[0] * px + (p[1] * py + (p[2] * z + p[9]));
        const float cy = p[3] * px + (p[4] * py + (p[5] * z + p[10]));
        const float cz = moved_z(units, i, j);
        if (!(cz > 0.0f)) return false;
        const float fu = (cx / cz) * p[12] + p[14] + 0.5f, fv = (cy / cz) * p[13] + p[15] + 0.5f;
        const float far = 1048576.0f;
        if (!(fu < far && fu > -far && fv < far && fv > -far)) return false;
        column = (int)fu;
        row = (int)fv;
        return true;
    };
    // The smallest key of the depth pixels that cover column u, row v; all bits set: none does.
    // With a cap, those farther in the depth camera may be taken for none.
    auto smallest_key = [&](int u, int v, unsigned cap = 65535) -> unsigned {
        const unsigned nothing = 0xffffffffu;
        if ((frame_range >> 16) > (frame_range & 0xffffu)) return nothing;
        // The path of the pixel's centre through the depth image.
        const float kx = ((float)u - p[14]) * s[29], ky = ((float)v - p[15]) * s[30];
        const float shrink = 1.0f / FUSED(s[6], kx, FUSED(s[7], ky, s[8]));
        const float qx = FUSED(s[0], kx, FUSED(s[1], ky, s[2])) * shrink;
        const float qy = FUSED(s[3], kx, FUSED(s[4], ky, s[5])) * shrink;
        const float path_x = qx - s[12], path_y = qy - s[13];
        const float slope_x = s[9] - qx * s[11], slope_y = s[10] - qy * s[11];
        // The rows and columns 0 are hit from -1 on, as the dense kernel rounds towards zero.
        const float footprint = (u == 0 || v == 0 ? 3.0f : 1.0f) * SIZE(shrink);
        // The four signs are linear in row and column of the depth image.
        float across[4], down[4], start[4], constant[4];
        #pragma unroll
        for (int side = 0; side < 4; ++side) {
            const int a = 3 * (side & 1), last = side >> 1;  // left, top, right, bottom
            const int at = side & 1 ? v : u;
            const float edge = (float)at + (last ? (at == 0 ? -1.5f : -0.5f) : 0.5f);
            const float k = (edge - p[14 + (side & 1)]) * s[29 + (side & 1)];
            const float x = p[a] - k * p[6], y = p[a + 1] - k * p[7];
            const float add_x = s[25] + (last && fills ? s[27] : 0.0f);
            const float add_y = s[26] + (last && fills ? s[28] : 0.0f);
            const float sign = last ? -1.0f : 1.0f;
            across[side] = sign * (x * s[27]);
            down[side] = sign * (y * s[28]);
            start[side] = sign * ((p[a + 2] - k * p[8]) + x * add_x + y * add_y);
            constant[side] = sign * (s[31 + (side & 1)] - k * s[33]);
        }
        const unsigned safe = (unsigned)s[24];
        const bool turned = p[6] != 0.0f || p[7] != 0.0f;
        unsigned best = cap + 1;
        int best_i = 0, best_j = 0;
        auto walk = [&](int i0, int i1, int j0, int j1) {
            for (int i = i0; i <= i1; ++i) {
                float row[4];
                #pragma unroll
                for (int side = 0; side < 4; ++side)
                    row[side] = FUSED((float)i, down[side], start[side]);
                for (int j = j0; j <= j1; ++j) {
                    const unsigned units = image[(size_t)i * Wd + j];
                    const float z = (float)(int)units, column = (float)j;
                    float worst = FUSED(z, FUSED(column, across[0], row[0]), constant[0]);
                    #pragma unroll
                    for (int side = 1; side < 4; ++side) {
                        const float value =
                            FUSED(z, FUSED(column, across[side], row[side]), constant[side]);
                        worst = MOST(worst, value);
                    }
                    const float margin = FUSED(z, s[22], s[23]);
                    if (!(worst < margin) || units == 0 || units > best) continue;
                    if (worst > -margin || units < safe) {
                        int left, top, right, bottom;
                        if (!project(units, i, j, left, top)) continue;
                        right = left; bottom = top;
                        if (fills && !project(units, i + 1, j + 1, right, bottom)) continue;
                        left = MOST(left, 0); top = MOST(top, 0);
                        if (u < left || u > right || v < top || v > bottom) continue;
                    }
                    if (units == best
                        && !(turned && moved_z(units, i, j) < moved_z(units, best_i, best_j)))
                        continue;
                    best = units; best_i = i; best_j = j;
                }
            }
        };
        // The box of depth pixels around the path between two inverse depths; false if empty.
        int i0, i1, j0, j1;
        auto box = [&](float w0, float w1) -> bool {
            const float near0 = 1.0f - s[11] * w0, near1 = 1.0f - s[11] * w1;
            const float size = MOST(SIZE(near0), SIZE(near1)) * footprint, w = MOST(w0, w1);
            const float x0 = FUSED(slope_x, w0, path_x), x1 = FUSED(slope_x, w1, path_x);
            const float y0 = FUSED(slope_y, w0, path_y), y1 = FUSED(slope_y, w1, path_y);
            const float more_x = FUSED(s[16], size, s[17] * w);
            const float more_y = FUSED(s[20], size, s[21] * w);
            const float left = LEAST(x0, x1) - more_x - s[14];
            const float right = MOST(x0, x1) + more_x + s[15];
            const float top = LEAST(y0, y1) - more_y - s[18];
            const float bottom = MOST(y0, y1) + more_y + s[19];
            if (right < 0.0f || bottom < 0.0f || left > (float)(Wd - 1) || top > (float)(Hd - 1))
                return false;
            j0 = left <= 0.0f ? 0 : (int)left + ((float)(int)left < left);
            i0 = top <= 0.0f ? 0 : (int)top + ((float)(int)top < top);
            j1 = right >= (float)(Wd - 1) ? Wd - 1 : (int)right;
            i1 = bottom >= (float)(Hd - 1) ? Hd - 1 : (int)bottom;
            return j0 <= j1 && i0 <= i1;
        };
        const float nearest = 1.0f / (float)(int)(frame_range >> 16);
        const unsigned last = LEAST(frame_range & 0xffffu, cap);
        if (last < frame_range >> 16) return nothing;
        const float farthest = 1.0f / (float)(int)last;
        const float speed = MOST(SIZE(slope_x), SIZE(slope_y));
        const float length = speed * (nearest - farthest) * (1.0f / STEP);
        const int pieces = 1 + (int)LEAST(length, 16383.0f);
        const float step = (nearest - farthest) / (float)pieces;
        float w1 = nearest;
        for (int piece = 1; piece <= pieces; ++piece) {
            const float w0 = piece == pieces ? farthest : nearest - (float)piece * step;
            float high = w1, low = w0;
            w1 = w0;
            // All that is left is farther than what was found.
            if ((float)(int)best * high < 0.9999f) break;
            if (!box(low, high)) continue;
            unsigned least = 65535, most = 0;
            for (int i = i0 / TILE; i <= i1 / TILE; ++i)
                for (int j = j0 / TILE; j <= j1 / TILE; ++j) {
                    const unsigned range = tile_ranges[i * tiles_x + j];
                    least = LEAST(least, range >> 16);
                    most = MOST(most, range & 0xffffu);
                }
            if (least > most) continue;
            high = LEAST(high, 1.0f / (float)(int)least);
            low = MOST(low, 1.0f / (float)(int)most);
            if (low * 0.9999f > high || !box(low, high)) continue;
            walk(i0, i1, j0, j1);
        }
        if (best == cap + 1) return nothing;
        const float z = moved_z(best, best_i, best_j) / p[25] + 0.5f;
        return (best << 16) | (unsigned)(int)LEAST(z, 65534.0f);
    };
""".replace("STEP", "16.0f").replace("TILE", str(TILE))
"""C++ for CUDA and the CPU, the head of a native function: it defines ``smallest_key(u, v)``, the
key at column u and row v inside the image, all bits set where nothing hits. It reads the arguments
``b`` (the frame), ``depth``, ``tiles``, ``ranges``, ``corner_x``, ``corner_y``, ``parameters``,
``search`` and ``fills``, as ``align_points`` has them."""
