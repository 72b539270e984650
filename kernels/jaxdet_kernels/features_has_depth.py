"""Whether a frame has any depth in range at the colour pixels, without aligning it; for CUDA."""

import warp as wp

from jaxdet_kernels.align_search import SEARCH

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

_HAS_DEPTH = (
    """
#if defined(__CUDA_ARCH__)
    const int b = block;
    const unsigned least = bounds.data[0], most = bounds.data[1];
"""
    + SEARCH
    + """
    bool found = known.data[b];
    const bool measured = (frame_range >> 16) <= (frame_range & 0xffffu);
    for (int base = 0; base < width * height && measured; base += 256) {
        if (__syncthreads_or(found)) break;
        const int place = base + thread;
        if (place < width * height) {
            const unsigned key = smallest_key(place % width, place / width), z = key & 0xffffu;
            found = key != 0xffffffffu && z >= least && z <= most;
        }
    }
    found = __syncthreads_or(found);
    if (thread == 0) has_depth_out.data[b] = found;
#endif
"""
)


@wp.func_native(_HAS_DEPTH)
def _has_depth(
    block: int,
    thread: int,
    known: wp.array[wp.bool],
    depth: wp.array3d[wp.uint16],
    tiles: wp.array3d[wp.uint32],
    ranges: wp.array[wp.uint32],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    search: wp.array[wp.float32],
    bounds: wp.array[wp.uint16],
    fills: int,
    height: int,
    width: int,
    has_depth_out: wp.array[wp.bool],
): ...


@wp.kernel(launch_bounds=(256, 4))
def ground_has_depth(
    known: wp.array[wp.bool],
    depth: wp.array3d[wp.uint16],
    tiles: wp.array3d[wp.uint32],
    ranges: wp.array[wp.uint32],
    corner_x: wp.array2d[wp.float32],
    corner_y: wp.array2d[wp.float32],
    parameters: wp.array[wp.float32],
    search: wp.array[wp.float32],
    bounds: wp.array[wp.uint16],
    fills: int,
    height: int,
    width: int,
    has_depth_out: wp.array[wp.bool],
):
    """Whether any pixel has a depth in range, a block a frame; pixel by pixel unless ``known``."""
    i = wp.tid()
    _has_depth(
        i // 256, i % 256, known, depth, tiles, ranges, corner_x, corner_y, parameters, search,
        bounds, fills, height, width, has_depth_out,
    )  # fmt: skip
