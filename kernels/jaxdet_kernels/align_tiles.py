"""Stage align on CUDA for lenses without distortion: tiles in shared memory.

Twin of ``align_splat``, operation by operation. A block handles a tile of the depth image, gathers
its hits in shared memory and then lowers each colour pixel once; straight into the image where the
tile's hits spread too far.
"""

import warp as wp

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

TILE_BLOCK, TILE_ROWS, TILE_COLUMNS = 256, 16, 32
"""Threads of a block, and its tile of the depth image."""

_TILE = """
#if defined(__CUDA_ARCH__)
    const int Hd = depth.shape[1], Wd = depth.shape[2];
    const int H = keys_out.shape[1], W = keys_out.shape[2];
    const int tiles_x = (Wd + 31) / 32, tiles_y = (Hd + 15) / 16;
    const int b = block / (tiles_x * tiles_y), tile = block % (tiles_x * tiles_y);
    const int v0 = (tile / tiles_x) * 16 + thread / 32, u = (tile % tiles_x) * 32 + thread % 32;
    const int CAPACITY = 8192;
    __shared__ __align__(16) unsigned hits[CAPACITY];
    __shared__ int bounds[4];
    unsigned* image = keys_out.data + (size_t)b * H * W;
    const float* p = parameters.data;
    auto project = [&](float z, float x, float y, int& column, int& row, float& cz) -> bool {
        const float px = __fmul_rn(z, x), py = __fmul_rn(z, y);
        #define MOVED(i) __fadd_rn(__fmul_rn(p[3 * i], px), \\
            __fadd_rn(__fmul_rn(p[3 * i + 1], py), \\
            __fadd_rn(__fmul_rn(p[3 * i + 2], z), p[9 + i])))
        const float cx = MOVED(0), cy = MOVED(1);
        cz = MOVED(2);
        if (!(cz > 0.0f)) return false;
        const float rx = __fdiv_rn(cx, cz), ry = __fdiv_rn(cy, cz);
        const float fu = __fadd_rn(__fadd_rn(__fmul_rn(rx, p[12]), p[14]), 0.5f);
        const float fv = __fadd_rn(__fadd_rn(__fmul_rn(ry, p[13]), p[15]), 0.5f);
        if (!(fabsf(fu) < 1048576.0f && fabsf(fv) < 1048576.0f)) return false;
        column = (int)fu;
        row = (int)fv;
        return true;
    };
    int left[2], top[2], right[2], bottom[2];
    unsigned key[2];
    int low_u = 1 << 30, low_v = 1 << 30, high_u = -1, high_v = -1;
    if (thread == 0) { bounds[0] = bounds[1] = 1 << 30; bounds[2] = bounds[3] = -1; }
    for (int k = 0; k < 2; ++k) {
        const int v = v0 + 8 * k;
        left[k] = 0; right[k] = -1; top[k] = 0; bottom[k] = -1; key[k] = 0;
        const unsigned units = v < Hd && u < Wd ? depth.data[((size_t)b * Hd + v) * Wd + u] : 0;
        if (units == 0) continue;
        const float z = __fmul_rn((float)units, p[25]);
        float cz, ignored;
        int l, t, r, m;
        if (!project(z, corner_x.data[u], corner_y.data[(size_t)v * (Wd + 1)], l, t, cz)) continue;
        r = l; m = t;
        if (fills && !project(z, corner_x.data[u + 1], corner_y.data[(size_t)(v + 1) * (Wd + 1)],
                              r, m, ignored)) continue;
        l = max(l, 0); t = max(t, 0); r = min(r, W - 1); m = min(m, H - 1);
        if (l > r || t > m) continue;
        const float zf = fminf(__fadd_rn(__fdiv_rn(cz, p[25]), 0.5f), 65534.0f);
        key[k] = (units << 16) | (unsigned)zf;
        left[k] = l; top[k] = t; right[k] = r; bottom[k] = m;
        low_u = min(low_u, l); low_v = min(low_v, t);
        high_u = max(high_u, r); high_v = max(high_v, m);
    }
    low_u = __reduce_min_sync(0xffffffffu, low_u);
    low_v = __reduce_min_sync(0xffffffffu, low_v);
    high_u = __reduce_max_sync(0xffffffffu, high_u);
    high_v = __reduce_max_sync(0xffffffffu, high_v);
    __syncthreads();
    if (thread % 32 == 0 && high_u >= 0) {
        atomicMin(&bounds[0], low_u); atomicMin(&bounds[1], low_v);
        atomicMax(&bounds[2], high_u); atomicMax(&bounds[3], high_v);
    }
    __syncthreads();
    const int first_u = bounds[0], first_v = bounds[1];
    const int wide = bounds[2] - first_u + 1, tall = bounds[3] - first_v + 1;
    if (bounds[2] < 0) return;
    // Rows as long as a power of two, so that places and pixels need no division.
    const int bits = wide <= 32 ? 5 : wide <= 64 ? 6 : wide <= 128 ? 7 : 8, pitch = 1 << bits;
    if (wide <= pitch && tall <= CAPACITY >> bits) {
        const uint4 nothing = make_uint4(0xffffffffu, 0xffffffffu, 0xffffffffu, 0xffffffffu);
        for (int i = thread; i < tall << (bits - 2); i += 256) ((uint4*)hits)[i] = nothing;
        __syncthreads();
        #pragma unroll
        for (int k = 0; k < 2; ++k) {
            const int more = right[k] - left[k], down = bottom[k] - top[k];
            unsigned* at = hits + ((top[k] - first_v) << bits) + left[k] - first_u;
            if (more < 0) continue;
            if (more <= 2 && down <= 2) {
                #pragma unroll
                for (int i = 0; i < 9; ++i)
                    if (i / 3 <= down && i % 3 <= more)
                        atomicMin(at + ((i / 3) << bits) + i % 3, key[k]);
            } else {
                for (int row = 0; row <= down; ++row)
                    for (int column = 0; column <= more; ++column)
                        atomicMin(at + (row << bits) + column, key[k]);
            }
        }
        __syncthreads();
        unsigned* corner = image + (size_t)first_v * W + first_u;
        for (int i = thread; i < tall << bits; i += 256) {
            const unsigned hit = hits[i];
            if (hit != 0xffffffffu) atomicMin(corner + (i >> bits) * W + (i & (pitch - 1)), hit);
        }
    } else {
        for (int k = 0; k < 2; ++k)
            for (int row = top[k]; row <= bottom[k]; ++row)
                for (int column = left[k]; column <= right[k]; ++column)
                    atomicMin(&image[(size_t)row * W + column], key[k]);
    }
#endif
"""


@wp.func_native(_TILE)
def _tile(
    block: int,
    thread: int,
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    fills: int,
    keys_out: wp.array3d[wp.uint32],
): ...


@wp.kernel
def align_splat_tiles(
    depth: wp.array3d[wp.uint16],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    fills: int,
    keys_out: wp.array3d[wp.uint32],
):
    """A block a depth tile; for CUDA and colour cameras without distortion.

    The corner rays must be separable: a depth camera without distortion too.
    """
    i = wp.tid()
    _tile(i // 256, i % 256, depth, corner_x, corner_y, parameters, fills, keys_out)
