"""Stage align at single colour pixels: what the dense alignment puts there, and nothing else."""

import warp as wp

from jaxdet_kernels.align_search import SEARCH, TILE

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

_POINT = (
    SEARCH
    + """
    const size_t at = (size_t)b * u.shape[1] + m;
    keys_out.data[at] = u.data[at] < 0 ? 0xffffffffu : smallest_key(u.data[at], v.data[at]);
"""
)

_TILE_RANGE = """
    const int Hd = depth.shape[1], Wd = depth.shape[2];
    const int last = (i + 1) * TILE < Hd ? (i + 1) * TILE : Hd;
    const int end = (j + 1) * TILE < Wd ? (j + 1) * TILE : Wd;
    unsigned short least = 65535, most = 0;
    #if defined(__CUDA_ARCH__)
    const bool whole = Wd % 8 == 0;
    if (whole) {
        unsigned low = 0xffffffffu, high = 0;
        for (int y = i * TILE; y < last; ++y)
            for (int x = j * TILE; x < end; x += 8) {
                const uint4 eight = *(const uint4*)(depth.data + ((size_t)b * Hd + y) * Wd + x);
                const unsigned pairs[4] = {eight.x, eight.y, eight.z, eight.w};
                #pragma unroll
                for (int k = 0; k < 4; ++k) {
                    low = __vminu2(low, __vsub2(pairs[k], 0x00010001u));
                    high = __vmaxu2(high, pairs[k]);
                }
            }
        least = min(low & 0xffffu, low >> 16);
        most = max(high & 0xffffu, high >> 16);
    }
    #else
    const bool whole = false;
    #endif
    for (int y = i * TILE; y < last && !whole; ++y) {
        const unsigned short* row = depth.data + ((size_t)b * Hd + y) * Wd;
        for (int x = j * TILE; x < end; ++x) {
            // No measurement, 0, wraps to the largest number.
            const unsigned short less = (unsigned short)(row[x] - 1);
            least = less < least ? less : least;
            most = row[x] > most ? row[x] : most;
        }
    }
    const unsigned nearest = least == 65535 ? 65535u : least + 1u;
    tiles_out.data[((size_t)b * tiles_out.shape[1] + i) * tiles_out.shape[2] + j] =
        (nearest << 16) | most;
""".replace("TILE", str(TILE))


@wp.func_native(_TILE_RANGE)
def _tile_range(
    b: int, i: int, j: int, depth: wp.array3d[wp.uint16], tiles_out: wp.array3d[wp.uint32]
): ...


@wp.kernel
def align_tile_ranges(depth: wp.array3d[wp.uint16], tiles_out: wp.array3d[wp.uint32]):
    """Nearest depth << 16 | farthest of each tile, a thread a tile; 65535 << 16 where none."""
    b, i, j = wp.tid()
    _tile_range(b, i, j, depth, tiles_out)


@wp.func_native(_POINT)
def _point(
    b: int,
    m: int,
    depth: wp.array3d[wp.uint16],
    tiles: wp.array3d[wp.uint32],
    ranges: wp.array[wp.uint32],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    search: wp.array[wp.float32],
    fills: int,
    u: wp.array2d[wp.int32],
    v: wp.array2d[wp.int32],
    keys_out: wp.array2d[wp.uint32],
): ...


@wp.kernel(launch_bounds=(256, 4))
def align_points(
    depth: wp.array3d[wp.uint16],
    tiles: wp.array3d[wp.uint32],
    ranges: wp.array[wp.uint32],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    search: wp.array[wp.float32],
    fills: int,
    u: wp.array2d[wp.int32],
    v: wp.array2d[wp.int32],
    keys_out: wp.array2d[wp.uint32],
):
    """A thread a point: the key at its column ``u`` and row ``v``, all bits set where none is.

    Where ``u`` is negative there is no pixel, and none is looked for.
    """
    b, m = wp.tid()
    _point(
        b, m, depth, tiles, ranges, corner_x, corner_y, parameters, search, fills, u, v, keys_out
    )
