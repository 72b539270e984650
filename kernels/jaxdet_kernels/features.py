"""Canny edges and Shi-Tomasi corners. Twin of the reference's ``_canny.py`` and ``_corners.py``.

On the CPU a frame is a thread's, from its colours to its corners. On CUDA the steps are kernels of
their own: weak and strong edges by tiles, hysteresis by frames, local maxima of the corner strength
by tiles, and the selection by frames. Images of bits are laid out as ``pixel_bits.h`` says.
"""

import warp as wp

from jaxdet_kernels.build import options

# With Warp's own flags for the CPU, which inline more: corners are 7 % faster.
wp.set_module_options(
    options(
        "corners.h",
        "image_tile.h",
        "canny.h",
        "corner_settings.h",
        "hysteresis.h",
        "corner_maxima.h",
        "corner_selection.h",
        "frames.h",
        cpu_flags=None,
    )
)

Color, Bits = wp.array4d[wp.uint8], wp.array3d[wp.uint32]
Ints, Ints2d = wp.array[wp.int32], wp.array2d[wp.int32]
TYPES = Color, Bits, Ints, Ints2d, Ints2d, Ints, Ints
"""Of the arrays of a call, those of :func:`features_frames` but the last."""

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
    """32-bit words of scratch memory of :func:`features_frames`, see ``corners.h``."""
    spaced = 2 * (height * (row_words(width) // 16 * 8 + 8) + 16)
    return 4 * height * width + 2 * spaced + 2 * height * row_words(width)


@wp.func_native("""
#if !defined(__CUDA_ARCH__)
    using namespace jaxdet;
    const int height = color.shape[1], width = color.shape[2], slots = u_out.shape[1];
    each_frame(next.data, color.shape[0], [&](size_t b) {
        found_out.data[b] = Corners{
            color.data + 3 * b * height * width, mask.data + b * height * PixelBits::words(width),
            height, width, {settings.data}, slots, u_out.data + b * slots, v_out.data + b * slots,
            (unsigned*)scratch.data}.run();
    });
#endif
""")
def _features_frames(
    color: Color,
    mask: Bits,
    settings: Ints,
    u_out: Ints2d,
    v_out: Ints2d,
    found_out: Ints,
    scratch: Ints,
    next: Ints,
): ...


@wp.kernel
def features_frames(
    color: Color,  # (B, H, W, 3) RGB
    mask: Bits,  # (B, H, words) where corners may be, a bit a pixel
    settings: Ints,  # (6,) see corner_settings.h
    u_out: Ints2d,  # (B, N) columns, strongest corner first; 0 where there is none
    v_out: Ints2d,  # rows
    found_out: Ints,  # (B,) how many corners there are, at most N + 1
    scratch: Ints,  # (features_scratch,)
    next: Ints,
):
    """The strongest corners of frames until none is left, on the CPU."""
    _features_frames(color, mask, settings, u_out, v_out, found_out, scratch, next)


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    using namespace jaxdet;
    typedef CannySuppressTile Tile;
    const Team team(tid, 0);
    const int height = color.shape[1], width = color.shape[2];
    const ImageTile at(team, Tile::ROWS, Tile::COLUMNS, height, width);
    const size_t pixels = (size_t)at.image * height, bits = pixels * PixelBits::words(width);
    const CornerSettings given{settings.data};
    Tile{team.rank, color.data + 3 * pixels * width, height, width, at.top, at.left, given.low(),
         given.high(), weak_out.data + bits, strong_out.data + bits}.run();
#endif
""")
def _canny_suppress(
    tid: int,
    color: Color,
    settings: Ints,
    weak_out: Bits,
    strong_out: Bits,
): ...


@wp.kernel(launch_bounds=(SUPPRESS_THREADS, 4))
def canny_suppress(
    color: Color,  # (B, H, W, 3) RGB
    settings: Ints,  # (6,)
    weak_out: Bits,  # (B, H, words) edges above the lower threshold
    strong_out: Bits,  # (B, H, words) those above the higher one
):
    """Grey, 3x3 Sobel and non-maximum suppression, a block a tile; for CUDA."""
    _canny_suppress(wp.tid(), color, settings, weak_out, strong_out)


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    using namespace jaxdet;
    const Team team(tid, 0);
    const int height = weak.shape[1];
    const size_t bits = (size_t)team.index * height * weak.shape[2];
    Hysteresis{team, height, width, weak.data + bits, strong.data + bits,
               edges_out.data + bits}.run();
#endif
""")
def _canny_hysteresis(
    tid: int,
    width: int,
    weak: Bits,
    strong: Bits,
    edges_out: Bits,
): ...


@wp.kernel(launch_bounds=(HYSTERESIS_THREADS, 3))
def canny_hysteresis(
    width: int,  # of the images
    weak: Bits,  # (B, H, words)
    strong: Bits,  # (B, H, words) some of these
    edges_out: Bits,  # (B, H, words)
):
    """Weak edges that are connected to strong ones, a block a frame; for CUDA."""
    _canny_hysteresis(wp.tid(), width, weak, strong, edges_out)


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    using namespace jaxdet;
    typedef CornerTile Tile;
    const Team team(tid, 0);
    const int height = strength_out.shape[1], width = strength_out.shape[2];
    const ImageTile at(team, Tile::ROWS, Tile::COLUMNS, height, width);
    const size_t pixels = (size_t)at.image * height, bits = pixels * PixelBits::words(width);
    Tile{team.rank, edges.data + bits, mask.data + bits, CornerSettings{settings.data}.everywhere(),
         height, width, at.top, at.left, strength_out.data + pixels * width, maxima_out.data + bits,
         strongest_out.data + at.image}.run();
#endif
""")
def _corners_maxima(
    tid: int,
    edges: Bits,
    mask: Bits,
    settings: Ints,
    strongest_out: Ints,
    maxima_out: Bits,
    strength_out: wp.array3d[wp.float32],
): ...


@wp.kernel(launch_bounds=(MAXIMA_THREADS, 6))
def corners_maxima(
    edges: Bits,  # (B, H, words)
    mask: Bits,  # (B, H, words) where corners may be
    settings: Ints,  # (6,)
    strongest_out: Ints,  # (B,) 0 before: the strongest allowed pixel's float32 bits
    maxima_out: Bits,  # (B, H, words) 0 before: maxima above 0
    strength_out: wp.array3d[wp.float32],  # (B, H, W) written at maxima alone
):
    """Allowed local maxima of the corner strength, a block a tile; for CUDA."""
    _corners_maxima(wp.tid(), edges, mask, settings, strongest_out, maxima_out, strength_out)


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    using namespace jaxdet;
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
""")
def _corners_select(
    tid: int,
    strongest: Ints,
    strength: wp.array3d[wp.float32],
    settings: Ints,
    maxima_out: Bits,
    u_out: Ints2d,
    v_out: Ints2d,
    found_out: Ints,
    open_out: Bits,
    taken_out: Bits,
    keys_out: wp.array2d[wp.uint32],
): ...


@wp.kernel(launch_bounds=(SELECT_THREADS, 1))
def corners_select(
    strongest: Ints,  # (B,) from corners_maxima
    strength: wp.array3d[wp.float32],  # (B, H, W) likewise
    settings: Ints,  # (6,)
    maxima_out: Bits,  # (B, H, words) likewise; those too weak are taken out
    u_out: Ints2d,  # (B, N) columns, strongest corner first; 0 where there is none
    v_out: Ints2d,  # rows
    found_out: Ints,  # (B,) how many corners there are, maybe more than N
    open_out: Bits,  # (B, H, words) scratch
    taken_out: Bits,  # (B, H, words) scratch
    keys_out: wp.array2d[wp.uint32],  # (B, 2 P) scratch; P is a power of two and at least N
):
    """The strongest N corners that keep the minimum distance, a block a frame; for CUDA."""
    _corners_select(
        wp.tid(),
        strongest,
        strength,
        settings,
        maxima_out,
        u_out,
        v_out,
        found_out,
        open_out,
        taken_out,
        keys_out,
    )
