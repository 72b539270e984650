"""Obstacles from surfaces. Twin of ``jaxdet/reference/_obstacles.py``."""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, native_kernel

wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})

MAX_SURFACES = 512
"""Most surfaces of a frame."""
MAX_LABELS = 1024
"""Most parts of obstacles, once those that bend are split."""


def scratch_words(rows: int, columns: int) -> int:
    """How much scratch memory a team needs, as ``lay`` in ``native/obstacles.h`` uses it.

    Args:
        rows: ``R``.
        columns: ``C``.
    """
    cells = rows * columns
    slots, labels = min(cells, MAX_SURFACES), min(cells, MAX_LABELS)
    pairs, keys = slots * slots, slots * columns
    longs = [max(2 * pairs, keys, 128 * labels), keys, slots, 6]
    words = [2 * one for one in longs]
    words += [pairs, pairs // 2, (pairs // 2 + 3) // 4]
    words += 2 * [cells + slots] + 3 * [cells]
    words += [labels + 1, *(3 * [19 * labels]), *(3 * [labels])]
    words += [2 * labels, labels, 6 * labels, 2 * labels + 1, 6] + 4 * [cells]
    words += [2 * (rows * _words(columns) + columns * _words(rows))]
    return sum(-(-one // 16) * 16 for one in words)


def _words(cells: int) -> int:
    """Words of a row of bits, a power of two."""
    return 1 << (-(-cells // 32) - 1).bit_length()


@native_kernel(
    "lanes.h",
    "bits.h",
    "listed.h",
    "extents.h",
    "contours.h",
    "numbering.h",
    "pieces.h",
    "facing.h",
    "evidence.h",
    "contraction.h",
    "straight_parts.h",
    "obstacles.h",
    body="""
    const Team team(tid, share);
    const int batch = label.shape[0];
    Obstacles frame;
#if defined(__CUDA_ARCH__)
    __shared__ __align__(16) int fast[Obstacles::FAST];
    frame.fast = fast;
#else
    frame.fast = nullptr;
#endif
    frame.rows = label.shape[1];
    frame.columns = label.shape[2];
    frame.settings = settings.data;
    frame.trees = {feature.data, threshold.data, value.data, value.shape[0], value.shape[1],
                   settings.data[Obstacles::OFFSET]};
    frame.lay(scratch_out.data + (size_t)team.index * scratch_out.shape[1]);
    for (int b = team.index; b < batch; b += shares) {
        const size_t at = (size_t)b * frame.rows * frame.columns;
        frame.surface = label.data + at;
        frame.free = (const unsigned char*)free.data + at;
        frame.x = x.data + at;
        frame.y = y.data + at;
        frame.z = z.data + at;
        frame.right = right.data + at;
        frame.forward = forward.data + at;
        frame.height = height.data + at;
        frame.in_view = (const unsigned char*)in_view.data + at;
        frame.label = label_out.data + at;
        frame.total = count_out.data + b;
        frame.run(team);
    }
""",
)
def obstacles(
    tid: int,
    share: int,
    shares: int,
    label: wp.array3d[wp.int32],
    free: wp.array3d[wp.bool],
    x: wp.array3d[wp.int32],
    y: wp.array3d[wp.int32],
    z: wp.array3d[wp.int32],
    right: wp.array3d[wp.int32],
    forward: wp.array3d[wp.int32],
    height: wp.array3d[wp.int32],
    in_view: wp.array3d[wp.bool],
    feature: wp.array2d[wp.int32],
    threshold: wp.array2d[wp.int32],
    value: wp.array2d[wp.int32],
    settings: wp.array[wp.int32],
    label_out: wp.array3d[wp.int32],
    count_out: wp.array[wp.int32],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        tid: Of the launch.
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        label: ``(B, R, C)`` surfaces ``0 .. S - 1`` of each frame, each with a cell, -1 = none; at
            most ``MAX_SURFACES``, at most 512 rows and columns.
        free: ``(B, R, C)``, measured to be free.
        x: ``(B, R, C)``, colour optical frame [depth units].
        y: Likewise.
        z: Likewise, 0 = no measurement, at most 65535.
        right: ``(B, R, C)``, on the floor [depth units].
        forward: Likewise.
        height: Above the floor.
        in_view: ``(B, R, C)``, at least partly in the colour image.
        feature: ``(T, 2**D - 1)``, which of what is seen a node looks at.
        threshold: ``(T, 2**D - 1)``, what is larger goes to the second child.
        value: ``(T, 2**D)``, evidence of the leaves.
        settings: See :class:`jaxdet.stages._obstacles.Settings`.
        label_out: ``(B, R, C)`` obstacles by distance, -1 = none.
        count_out: ``(B,)``, how many there are.
        scratch_out: ``(teams, scratch_words(R, C))``.
    """
