"""Canny edges and Shi-Tomasi corners. Twin of the reference's ``_canny.py`` and ``_corners.py``.

On the CPU a frame is a thread's, from its colours to its corners. On CUDA the steps are kernels of
their own: weak and strong edges by tiles, hysteresis by frames, local maxima of the corner strength
by tiles, and the selection by frames. Images of bits are laid out as ``include/jaxdet/pixel_bits.h`` says.
"""

import warp as wp

from jaxdet_kernels.native_source import includes, native_kernel, team_kernel

# With Warp's own flags for the CPU, which inline more: corners are 7 % faster.
wp.set_module_options(
    {
        "fuse_fp": False,
        "enable_backward": False,
        "extra_build_options": includes(
            "corners.h",
            "image_tile.h",
            "canny.h",
            "corner_settings.h",
            "hysteresis.h",
            "corner_maxima.h",
            "corner_selection.h",
        ),
    }
)

MAX_SIZE = 4096  # most columns and rows of a colour image

SUPPRESS_THREADS, SUPPRESS_ROWS, SUPPRESS_COLUMNS = 256, 48, 128
"""Threads of a block, and its tile of an image."""

HYSTERESIS_THREADS = 512  # of a block, which has a frame

MAXIMA_THREADS, MAXIMA_ROWS, MAXIMA_COLUMNS = 128, 48, 64
"""Threads of a block, and its tile of an image."""

SELECT_THREADS = 1024  # of a block, which has a frame


def row_words(width: int) -> int:
    """32-bit words of a row of bits."""
    return 2 * -(-width // 64)


def features_scratch(height: int, width: int) -> int:
    """32-bit words of scratch memory of :func:`features_frames`, see ``include/jaxdet/corners.h``."""
    spaced = 2 * (height * (row_words(width) // 16 * 8 + 8) + 16)
    return 4 * height * width + 2 * spaced + 2 * height * row_words(width)


@team_kernel(
    body="""
#if !defined(__CUDA_ARCH__)
        const int height = color.shape[1], width = color.shape[2];
        const size_t at = (size_t)b * u_out.shape[1];
        found_out.data[b] = Corners{
            color.data + 3 * (size_t)b * height * width,
            mask.data + (size_t)b * height * PixelBits::words(width), height, width,
            {settings.data}, u_out.shape[1], u_out.data + at, v_out.data + at,
            (unsigned*)scratch}.run();
#endif
""",
)
def features_frames(
    color: wp.array4d[wp.uint8],  # (B, H, W, 3) RGB
    mask: wp.array3d[wp.uint32],  # (B, H, words) where corners may be, a bit a pixel
    settings: wp.array[wp.int32],  # (6,) see corner_settings.h
    u_out: wp.array2d[wp.int32],  # (B, N) columns, strongest corner first; 0 where there is none
    v_out: wp.array2d[wp.int32],  # rows
    found_out: wp.array[wp.int32],  # (B,) how many corners there are, at most N + 1
):
    """The strongest corners, on the CPU; ``features_scratch`` of scratch memory."""


@native_kernel(
    body="""
#if defined(__CUDA_ARCH__)
    typedef CannySuppressTile Tile;
    const Team team(tid, 0);
    const int height = color.shape[1], width = color.shape[2];
    const ImageTile at(team, Tile::ROWS, Tile::COLUMNS, height, width);
    const size_t pixels = (size_t)at.image * height, bits = pixels * PixelBits::words(width);
    const CornerSettings given{settings.data};
    Tile{team.rank, color.data + 3 * pixels * width, height, width, at.top, at.left, given.low(),
         given.high(), weak_out.data + bits, strong_out.data + bits}.run();
#endif
""",
    launch_bounds=(SUPPRESS_THREADS, 4),
)
def canny_suppress(
    color: wp.array4d[wp.uint8],  # (B, H, W, 3) RGB
    settings: wp.array[wp.int32],  # (6,)
    weak_out: wp.array3d[wp.uint32],  # (B, H, words) edges above the lower threshold
    strong_out: wp.array3d[wp.uint32],  # (B, H, words) those above the higher one
):
    """Grey, 3x3 Sobel and non-maximum suppression, a block a tile; for CUDA."""


@native_kernel(
    body="""
#if defined(__CUDA_ARCH__)
    const Team team(tid, 0);
    const int height = weak.shape[1];
    const size_t bits = (size_t)team.index * height * weak.shape[2];
    Hysteresis{team, height, width, weak.data + bits, strong.data + bits,
               edges_out.data + bits}.run();
#endif
""",
    launch_bounds=(HYSTERESIS_THREADS, 3),
)
def canny_hysteresis(
    width: int,  # of the images
    weak: wp.array3d[wp.uint32],  # (B, H, words)
    strong: wp.array3d[wp.uint32],  # (B, H, words) some of these
    edges_out: wp.array3d[wp.uint32],  # (B, H, words)
):
    """Weak edges that are connected to strong ones, a block a frame; for CUDA."""


@native_kernel(
    body="""
#if defined(__CUDA_ARCH__)
    typedef CornerTile Tile;
    const Team team(tid, 0);
    const int height = strength_out.shape[1], width = strength_out.shape[2];
    const ImageTile at(team, Tile::ROWS, Tile::COLUMNS, height, width);
    const size_t pixels = (size_t)at.image * height, bits = pixels * PixelBits::words(width);
    Tile{team.rank, edges.data + bits, mask.data + bits, CornerSettings{settings.data}.everywhere(),
         height, width, at.top, at.left, strength_out.data + pixels * width, maxima_out.data + bits,
         strongest_out.data + at.image}.run();
#endif
""",
    launch_bounds=(MAXIMA_THREADS, 6),
)
def corners_maxima(
    edges: wp.array3d[wp.uint32],  # (B, H, words)
    mask: wp.array3d[wp.uint32],  # (B, H, words) where corners may be
    settings: wp.array[wp.int32],  # (6,)
    strongest_out: wp.array[wp.int32],  # (B,) 0 before: the strongest allowed pixel's float32 bits
    maxima_out: wp.array3d[wp.uint32],  # (B, H, words) 0 before: maxima above 0
    strength_out: wp.array3d[wp.float32],  # (B, H, W) written at maxima alone
):
    """Allowed local maxima of the corner strength, a block a tile; for CUDA."""


@native_kernel(
    body="""
#if defined(__CUDA_ARCH__)
    const Team team(tid, 0);
    const int height = strength.shape[1], width = strength.shape[2], slots = u_out.shape[1];
    const size_t b = team.index, bits = b * height * PixelBits::words(width), out = b * slots;
    const CornerSettings given{settings.data};
    CornerSelection{team.rank, height, width, CornerDisk{given.limit()}, given.quality(),
                    __int_as_float(strongest.data[b]), strength.data + b * height * width,
                    maxima_out.data + bits, open_out.data + bits, taken_out.data + bits,
                    (unsigned long long*)(keys_out.data + b * keys_out.shape[1]), slots,
                    u_out.data + out, v_out.data + out, found_out.data + b}.run();
#endif
""",
    launch_bounds=(SELECT_THREADS, 1),
)
def corners_select(
    strongest: wp.array[wp.int32],  # (B,) from corners_maxima
    strength: wp.array3d[wp.float32],  # (B, H, W) likewise
    settings: wp.array[wp.int32],  # (6,)
    maxima_out: wp.array3d[wp.uint32],  # (B, H, words) likewise; those too weak are taken out
    u_out: wp.array2d[wp.int32],  # (B, N) columns, strongest corner first; 0 where there is none
    v_out: wp.array2d[wp.int32],  # rows
    found_out: wp.array[wp.int32],  # (B,) how many corners there are, maybe more than N
    open_out: wp.array3d[wp.uint32],  # (B, H, words) scratch
    taken_out: wp.array3d[wp.uint32],  # (B, H, words) scratch
    keys_out: wp.array2d[wp.uint32],  # (B, 2 P) scratch; P is a power of two and at least N
):
    """The strongest N corners that keep the minimum distance, a block a frame; for CUDA."""
