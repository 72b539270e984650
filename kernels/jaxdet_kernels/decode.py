"""Kernels that decode depth images of logs (PNG, RVL, metres), for the CPU only.

One thread decodes a complete image, because the threads of a CPU kernel run one after the other;
images are decoded in parallel because launches release the GIL. Arrays are contiguous.
"""

import warp as wp

from jaxdet_kernels.build import options

wp.set_module_options(options("png_depth.h", "rvl.h"))


@wp.func_native("""
    jaxdet::PngDepth{lines.data, lines.shape[0], lines.shape[1] / 2, depth_out.data}.run();
""")
def _png_depth(lines: wp.array2d[wp.uint8], depth_out: wp.array2d[wp.uint16]): ...


@wp.kernel
def png_depth(
    lines: wp.array2d[wp.uint8],  # (H, 1 + 2 W) lines, each preceded by its filter
    depth_out: wp.array2d[wp.uint16],  # (H, W)
):
    """Decode the filtered lines of a 16-bit grey PNG; filters are 0 to 4."""
    _png_depth(lines, depth_out)


@wp.func_native("""
    const long long pixels = (long long)pixels_out.shape[0] * pixels_out.shape[1];
    jaxdet::RvlDecoder decoder{{stream.data, stream.shape[0] / 4}, pixels_out.data, pixels, {}};
    status_out.data[0] = decoder.run();
""")
def _rvl(
    stream: wp.array[wp.uint8], pixels_out: wp.array2d[wp.uint16], status_out: wp.array[wp.int32]
): ...


@wp.kernel
def rvl(
    stream: wp.array[wp.uint8],  # (N,) bytes; those after the last pixel are ignored
    pixels_out: wp.array2d[wp.uint16],  # (H, W) depth, incomplete if the status is not 0
    status_out: wp.array[wp.int32],  # (1,) 0 on success, otherwise an error of RvlDecoder
):
    """Decode an RVL stream."""
    _rvl(stream, pixels_out, status_out)


@wp.func_native("""
    const size_t size = (size_t)metres.shape[0] * metres.shape[1];
    for (size_t i = 0; i < size; ++i) {
        const double units = __builtin_rint(metres.data[i] / unit_m);
        units_out.data[i] = (unsigned short)(units > 0 && units <= 65535 ? (int)units : 0);
    }
""")
def _depth_units(
    metres: wp.array2d[wp.float32], unit_m: wp.float64, units_out: wp.array2d[wp.uint16]
): ...


@wp.kernel
def depth_units(
    metres: wp.array2d[wp.float32],  # (H, W)
    unit_m: wp.float64,  # metres per depth unit
    units_out: wp.array2d[wp.uint16],  # (H, W)
):
    """Round metres to depth units, halves to even; results outside 1 to 65535 become 0."""
    _depth_units(metres, unit_m, units_out)
