"""Obstacles from surfaces. Twin of ``jaxdet/reference/_obstacles.py``."""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, bit_words, team_kernel

wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})


def scratch_words(rows: int, columns: int, surfaces: int, labels: int) -> int:
    """How much scratch memory a team needs, as ``allocate`` in ``native/obstacles.h`` uses it.

    Args:
        rows: ``R``.
        columns: ``C``.
        surfaces: Most of a frame, ``MAX_SURFACES`` there.
        labels: Most parts of obstacles, once those that bend are split; ``MAX_LABELS`` there.
    """
    cells = rows * columns
    slots, labels = min(cells, surfaces), min(cells, labels)
    pairs, keys = slots * slots, slots * columns
    longs = [max(2 * pairs, keys), keys, slots, 6]
    words = [2 * one for one in longs] + [pairs, pairs // 2, (pairs // 2 + 3) // 4]
    words += 2 * [cells + slots] + 7 * [cells] + 3 * [18 * labels] + 4 * [labels]
    words += [labels + 1, 2 * labels + 1, 2 * labels + 1, 6]
    words += [2 * (bit_words(rows, columns) + bit_words(columns, rows))]
    return sum(-(-one // 16) * 16 for one in words)


@team_kernel(
    "obstacles.h",
    body="""
        const size_t at = (size_t)b * label.shape[1] * label.shape[2];
#if defined(__CUDA_ARCH__)
        __shared__ __align__(16) int fast[Obstacles::FAST];
#else
        int* const fast = nullptr;
#endif
        Obstacles frame{fast, label.shape[1], label.shape[2], label.data + at, x.data + at,
                        y.data + at, z.data + at, right.data + at, forward.data + at,
                        height.data + at, (const unsigned char*)free.data + at,
                        settings.data,
                        {feature.data, threshold.data, value.data, value.shape[0], value.shape[1],
                         settings.data[Obstacles::OFFSET]}, label_out.data + at,
                        count_out.data + b};
        frame.allocate(scratch);
        frame.run(team);
""",
)
def obstacles(
    label: wp.array3d[wp.int32],  # (B, R, C) surfaces 0 .. S - 1, each has a cell, -1 = none
    free: wp.array3d[wp.bool],  # (B, R, C) measured to be free
    x: wp.array3d[wp.int32],  # (B, R, C) depth optical frame [depth units]
    y: wp.array3d[wp.int32],
    z: wp.array3d[wp.int32],  # 0 = no measurement, at most 65535
    right: wp.array3d[wp.int32],  # (B, R, C) on the floor [depth units]
    forward: wp.array3d[wp.int32],
    height: wp.array3d[wp.int32],  # above the floor
    feature: wp.array2d[wp.int32],  # (T, 2**D - 1) which of what is seen a node looks at
    threshold: wp.array2d[wp.int32],  # (T, 2**D - 1) what is larger goes to the second child
    value: wp.array2d[wp.int32],  # (T, 2**D) evidence of the leaves
    settings: wp.array[wp.int32],  # (11,) see native/obstacles.h
    label_out: wp.array3d[wp.int32],  # (B, R, C) obstacles by distance, -1 = none
    count_out: wp.array[wp.int32],  # (B,) how many there are
):
    """At most 512 rows, columns and surfaces; ``scratch_words`` of scratch memory."""
