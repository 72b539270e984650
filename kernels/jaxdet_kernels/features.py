"""Canny edges and Shi-Tomasi corners. Twin of the reference's ``_canny.py`` and ``_corners.py``.

On the CPU a frame is a thread's, from its colours to its corners. On CUDA the steps are kernels of
their own: weak and strong edges by tiles, hysteresis by frames, local maxima of the corner strength
by tiles, and the selection by frames. Images of bits are laid out as ``native/pixel_bits.h`` says.
"""

import warp as wp

from jaxdet_kernels.native_source import native

wp.set_module_options({"fuse_fp": False, "enable_backward": False})

MAX_SIZE = 4096
"""Most columns and rows of a colour image."""

SETTINGS = 6
"""Values of ``native/corner_settings.h``."""

SUPPRESS_THREADS, SUPPRESS_ROWS, SUPPRESS_COLUMNS = 256, 48, 128
"""Threads of a block, and its tile of an image."""

HYSTERESIS_THREADS = 512
"""Of a block, which has a frame."""

MAXIMA_THREADS, MAXIMA_ROWS, MAXIMA_COLUMNS = 128, 48, 64
"""Threads of a block, and its tile of an image."""

SELECT_THREADS = 1024
"""Of a block, which has a frame."""


def row_words(width: int) -> int:
    """32-bit words of a row of bits."""
    return 2 * -(-width // 64)


def features_scratch(height: int, width: int) -> int:
    """32-bit words of scratch memory that :func:`features_frames` takes."""
    return 4 * height * width + 4 * height * row_words(width)


@wp.func_native(
    native(
        "vectors.h",
        "pixel_bits.h",
        "canny.h",
        "hysteresis.h",
        "corner_settings.h",
        "corner_strength.h",
        "corner_maxima.h",
        "corner_selection.h",
        body="""
#if !defined(__CUDA_ARCH__)
    const Team team(0, 0);
    const int height = color.shape[1], width = color.shape[2], slots = u_out.shape[1];
    const size_t bits = (size_t)height * PixelBits::words(width);
    const size_t pixels = (size_t)height * width;
    const CornerSettings given{settings.data};
    typedef unsigned long long Key;
    Key* list = (Key*)(scratch_out.data + (size_t)share * scratch_out.shape[1]);
    unsigned *weak = (unsigned*)(list + 2 * pixels), *strong = weak + bits;
    unsigned *edges = strong + bits, *blocked = edges + bits;
    CannySuppress{color.data + 3 * b * pixels, height, width, given.low(), given.high(), weak,
                  strong}.run();
    Hysteresis{team, height, width, weak, strong, edges}.run();
    const int count = CornerMaxima{edges, mask.data + b * bits, given.everywhere(), height, width,
                                   given.quality(), list}.run();
    CornerSelection select{height, width, CornerDisk{given.limit()}, slots, list, list + pixels,
                           count, blocked, u_out.data + (size_t)b * slots,
                           v_out.data + (size_t)b * slots};
    found_out.data[b] = select.run();
#endif
""",
    )
)
def _features_frame(
    b: int,
    share: int,
    color: wp.array4d[wp.uint8],
    mask: wp.array3d[wp.uint32],
    settings: wp.array[wp.int32],
    u_out: wp.array2d[wp.int32],
    v_out: wp.array2d[wp.int32],
    found_out: wp.array[wp.int32],
    scratch_out: wp.array2d[wp.uint32],
): ...


@wp.kernel
def features_frames(
    share: int,
    shares: int,
    color: wp.array4d[wp.uint8],
    mask: wp.array3d[wp.uint32],
    settings: wp.array[wp.int32],
    u_out: wp.array2d[wp.int32],
    v_out: wp.array2d[wp.int32],
    found_out: wp.array[wp.int32],
    scratch_out: wp.array2d[wp.uint32],
):
    """The corners of a frame a thread, ``share + shares * i``; for the CPU.

    Args:
        share: The first frame of the launch.
        shares: How many launches there are.
        color: ``(B, H, W, 3)``, RGB.
        mask: ``(B, H, words)``, where corners may be, a bit a pixel.
        settings: ``(SETTINGS,)``, see ``native/corner_settings.h``.
        u_out: ``(B, N)``, columns, strongest corner first; 0 where there is none.
        v_out: ``(B, N)``, rows.
        found_out: ``(B,)``, how many corners there are, at most N + 1.
        scratch_out: ``(shares, features_scratch)``.
    """
    b = share + shares * wp.tid()
    _features_frame(b, share, color, mask, settings, u_out, v_out, found_out, scratch_out)


@wp.func_native(
    native(
        "vectors.h",
        "pixel_bits.h",
        "canny.h",
        "corner_settings.h",
        body="""
#if defined(__CUDA_ARCH__)
    const int height = color.shape[1], width = color.shape[2];
    const int across = CannySuppressTile::tiles_across(width);
    const int tiles = across * CannySuppressTile::tiles_down(height);
    const int b = block / tiles, tile = block - b * tiles;
    const size_t bits = (size_t)b * height * PixelBits::words(width);
    const CornerSettings given{settings.data};
    CannySuppressTile{thread, color.data + 3 * (size_t)b * height * width, height, width,
                      tile / across * CannySuppressTile::ROWS,
                      tile % across * CannySuppressTile::COLUMNS, given.low(), given.high(),
                      weak_out.data + bits, strong_out.data + bits}.run();
#endif
""",
    )
)
def _suppress_tile(
    block: int,
    thread: int,
    color: wp.array4d[wp.uint8],
    settings: wp.array[wp.int32],
    weak_out: wp.array3d[wp.uint32],
    strong_out: wp.array3d[wp.uint32],
): ...


@wp.kernel(launch_bounds=(256, 4))
def canny_suppress(
    color: wp.array4d[wp.uint8],
    settings: wp.array[wp.int32],
    weak_out: wp.array3d[wp.uint32],
    strong_out: wp.array3d[wp.uint32],
):
    """Grey, 3x3 Sobel and non-maximum suppression, a block a tile; for CUDA.

    Args:
        color: ``(B, H, W, 3)``, RGB.
        settings: ``(SETTINGS,)``.
        weak_out: ``(B, H, words)``, edges above the lower threshold.
        strong_out: ``(B, H, words)``, those above the higher one.
    """
    i = wp.tid()
    _suppress_tile(i // 256, i % 256, color, settings, weak_out, strong_out)


@wp.func_native(
    native(
        "pixel_bits.h",
        "hysteresis.h",
        body="""
    const Team team(tid, 0);
    const int height = weak.shape[1];
    const size_t bits = (size_t)team.index * height * weak.shape[2];
    Hysteresis{team, height, width, weak.data + bits, strong.data + bits,
               edges_out.data + bits}.run();
""",
    )
)
def _hysteresis_frame(
    tid: int,
    width: int,
    weak: wp.array3d[wp.uint32],
    strong: wp.array3d[wp.uint32],
    edges_out: wp.array3d[wp.uint32],
): ...


@wp.kernel(launch_bounds=(512, 3))
def canny_hysteresis(
    width: int,
    weak: wp.array3d[wp.uint32],
    strong: wp.array3d[wp.uint32],
    edges_out: wp.array3d[wp.uint32],
):
    """Weak edges that hang together with strong ones, a block a frame; for CUDA.

    Args:
        width: Of the images.
        weak: ``(B, H, words)``.
        strong: ``(B, H, words)``, some of these.
        edges_out: ``(B, H, words)``.
    """
    _hysteresis_frame(wp.tid(), width, weak, strong, edges_out)


@wp.func_native(
    native(
        "vectors.h",
        "pixel_bits.h",
        "corner_settings.h",
        "corner_strength.h",
        "corner_maxima.h",
        body="""
#if defined(__CUDA_ARCH__)
    const int height = strength_out.shape[1], width = strength_out.shape[2];
    const int across = CornerTile::tiles_across(width);
    const int tiles = across * CornerTile::tiles_down(height);
    const int b = block / tiles, tile = block - b * tiles;
    const size_t bits = (size_t)b * height * PixelBits::words(width);
    const CornerSettings given{settings.data};
    CornerTile{thread, edges.data + bits, mask.data + bits, given.everywhere(), height, width,
               tile / across * CornerTile::ROWS, tile % across * CornerTile::COLUMNS,
               strength_out.data + (size_t)b * height * width, maxima_out.data + bits,
               strongest_out.data + b}.run();
#endif
""",
    )
)
def _maxima_tile(
    block: int,
    thread: int,
    edges: wp.array3d[wp.uint32],
    mask: wp.array3d[wp.uint32],
    settings: wp.array[wp.int32],
    strongest_out: wp.array[wp.int32],
    maxima_out: wp.array3d[wp.uint32],
    strength_out: wp.array3d[wp.float32],
): ...


@wp.kernel(launch_bounds=(128, 6))
def corners_maxima(
    edges: wp.array3d[wp.uint32],
    mask: wp.array3d[wp.uint32],
    settings: wp.array[wp.int32],
    strongest_out: wp.array[wp.int32],
    maxima_out: wp.array3d[wp.uint32],
    strength_out: wp.array3d[wp.float32],
):
    """Allowed local maxima of the corner strength, a block a tile; for CUDA.

    Args:
        edges: ``(B, H, words)``.
        mask: ``(B, H, words)``, where corners may be.
        settings: ``(SETTINGS,)``.
        strongest_out: ``(B,)``, zero before: the strongest allowed pixel's float32 as bits.
        maxima_out: ``(B, H, words)``, zero before: maxima above 0.
        strength_out: ``(B, H, W)``, written at maxima alone.
    """
    i = wp.tid()
    _maxima_tile(i // 128, i % 128, edges, mask, settings, strongest_out, maxima_out, strength_out)


@wp.func_native(
    native(
        "pixel_bits.h",
        "corner_settings.h",
        "corner_selection.h",
        body="""
#if defined(__CUDA_ARCH__)
    const int height = strength.shape[1], width = strength.shape[2], slots = u_out.shape[1];
    const size_t bits = (size_t)block * height * PixelBits::words(width);
    const size_t out = (size_t)block * slots;
    const CornerSettings given{settings.data};
    CornerSelection{thread, height, width, CornerDisk{given.limit()}, given.quality(),
                    __int_as_float(strongest.data[block]),
                    strength.data + (size_t)block * height * width, maxima_out.data + bits,
                    open_out.data + bits, taken_out.data + bits,
                    (unsigned long long*)(keys_out.data + (size_t)block * keys_out.shape[1]),
                    slots, u_out.data + out, v_out.data + out, found_out.data + block}.run();
#endif
""",
    )
)
def _select_frame(
    block: int,
    thread: int,
    strongest: wp.array[wp.int32],
    strength: wp.array3d[wp.float32],
    settings: wp.array[wp.int32],
    maxima_out: wp.array3d[wp.uint32],
    u_out: wp.array2d[wp.int32],
    v_out: wp.array2d[wp.int32],
    found_out: wp.array[wp.int32],
    open_out: wp.array3d[wp.uint32],
    taken_out: wp.array3d[wp.uint32],
    keys_out: wp.array2d[wp.uint32],
): ...


@wp.kernel(launch_bounds=1024)
def corners_select(
    strongest: wp.array[wp.int32],
    strength: wp.array3d[wp.float32],
    settings: wp.array[wp.int32],
    maxima_out: wp.array3d[wp.uint32],
    u_out: wp.array2d[wp.int32],
    v_out: wp.array2d[wp.int32],
    found_out: wp.array[wp.int32],
    open_out: wp.array3d[wp.uint32],
    taken_out: wp.array3d[wp.uint32],
    keys_out: wp.array2d[wp.uint32],
):
    """The strongest N corners that keep the minimum distance, a block a frame; for CUDA.

    Args:
        strongest: ``(B,)``, from :func:`corners_maxima`.
        strength: ``(B, H, W)``, likewise.
        settings: ``(SETTINGS,)``.
        maxima_out: ``(B, H, words)``, from :func:`corners_maxima`; those too weak are taken out.
        u_out: ``(B, N)``, columns, strongest corner first; 0 where there is none.
        v_out: ``(B, N)``, rows.
        found_out: ``(B,)``, how many corners there are, maybe more than N.
        open_out: ``(B, H, words)``, scratch.
        taken_out: ``(B, H, words)``, scratch.
        keys_out: ``(B, 2 P)``, scratch; P is a power of two and at least N.
    """
    i = wp.tid()
    _select_frame(
        i // 1024, i % 1024, strongest, strength, settings, maxima_out, u_out, v_out, found_out,
        open_out, taken_out, keys_out,
    )  # fmt: skip
