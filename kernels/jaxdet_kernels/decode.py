"""What images in logs are decoded with: PNG, RVL, depth in metres. For the CPU only.

One thread does a whole image, as threads of a CPU kernel run one after the other; images are
decoded side by side because a launch does not hold Python's lock. Arrays are contiguous.
"""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, includes, native_kernel

wp.set_module_options(
    {
        "enable_backward": False,
        "cpu_compiler_flags": CPU_FLAGS,
        "extra_build_options": includes("png_depth.h", "png_lines.h", "rvl.h"),
    }
)


@native_kernel(
    body="PngDepth{lines.data, lines.shape[0], lines.shape[1] / 2, depth_out.data}.run();",
)
def png_depth(
    lines: wp.array2d[wp.uint8],  # (H, 1 + 2 W) each begins with its filter
    depth_out: wp.array2d[wp.uint16],  # (H, W)
):
    """The lines of a 16-bit grey PNG to depth; filters are 0 to 4."""


@native_kernel(
    body="""
    PngLines{lines.data, lines.shape[0], lines.shape[1] - 1, step}.color(spread, rgb_out.data);
""",
)
def png_color(
    lines: wp.array2d[wp.uint8],  # (H, 1 + step W) likewise; un-filtered in place
    step: int,  # bytes of a pixel, 1, 2, 3, 4, 6 or 8
    spread: int,  # bytes from a sample to the next; 0: grey, which is repeated
    rgb_out: wp.array3d[wp.uint8],  # (H, W, 3)
):
    """The lines of a PNG with 8 or 16 bits a sample to RGB; of 16 bits the higher 8 are taken."""


@native_kernel(
    body="""
    RvlDecoder decoder{{stream.data, stream.shape[0] / 4},
                       pixels_out.data,
                       (long long)pixels_out.shape[0] * pixels_out.shape[1],
                       {}};
    status_out.data[0] = decoder.run();
""",
)
def rvl(
    stream: wp.array[wp.uint8],  # (N,) what follows the last pixel is not read
    pixels_out: wp.array2d[wp.uint16],  # (H, W) partly written where the status is not 0
    status_out: wp.array[wp.int32],  # (1,) 0 where all is well, else see RvlDecoder
):
    """An RVL stream to its pixels."""


@native_kernel(
    body="""
    const size_t size = (size_t)metres.shape[0] * metres.shape[1];
    for (size_t i = 0; i < size; ++i) {
        const double units = __builtin_rint(metres.data[i] / unit_m);
        units_out.data[i] = (unsigned short)(units > 0 && units <= 65535 ? (int)units : 0);
    }
""",
)
def depth_units(
    metres: wp.array2d[wp.float32],  # (H, W)
    unit_m: wp.float64,  # metres in a unit
    units_out: wp.array2d[wp.uint16],  # (H, W)
):
    """Metres to the nearest depth unit, halves to even; 0 where that is not of 1 to 65535."""
