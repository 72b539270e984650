"""The floor of each frame. Twin of ``_find`` in ``jaxdet/reference/_floor.py``."""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, team_kernel

wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})

_DIRECTIONS = 30 * 21  # without a prior
_NEAR_DIRECTIONS = 17 * 9
_FIXED_WORDS = 2048  # more than all that does not grow with the frame or the lattices
_WARP = 32
WIDTH = 256  # threads of a team on CUDA
_BLOCKS = 4  # on a multiprocessor at once: a thread has up to 64 registers
_LANES = 16  # directions that a vector has on the CPU


def floor_scratch_words(rows: int, columns: int, near_bins: int, wide_bins: int, runs: int) -> int:
    """32-bit words of scratch memory of a team, even, see ``native/floor.h``.

    ``rows`` times ``columns`` cells are used. So many heights are tried near a guess and without a
    prior. A profile of the floor has so many distances.
    """
    cells, few = rows * columns, -(-rows // 2) * -(-columns // 2)
    weights = max(-(-WIDTH // _WARP) * few, cells)
    near, wide = (-(-n // _WARP) * _WARP for n in (_NEAR_DIRECTIONS, _DIRECTIONS))
    lattice = max(near * (near_bins + 1), wide * (wide_bins + 1))
    ends = _LANES * (max(near_bins, wide_bins) + 1)
    words = _FIXED_WORDS + 6 * cells + 11 * few + weights + 8 * (runs + 1) + ends + lattice
    return words + words % 2


@team_kernel(
    "floor.h",
    body="""
#if defined(__CUDA_ARCH__)
        __shared__ __align__(16) int fast[Floor::SHARED];
#else
        int* const fast = nullptr;
#endif
        const int rows = z.shape[1], columns = z.shape[2];
        const Floor floor(team, settings.data, sines.data, prior.data + b * Floor::PRIOR, rows,
                          columns, scratch, fast);
        const size_t first = (size_t)b * rows * columns;
        floor.run(x.data + first, y.data + first, z.data + first, rows, columns,
                  found_out.data + b * Floor::RESULTS);
""",
    launch_bounds=(WIDTH, _BLOCKS),
)
def floor(
    x: wp.array3d[wp.int32],  # (B, R, C) depth optical frame [depth units]
    y: wp.array3d[wp.int32],
    z: wp.array3d[wp.int32],  # 0 = no measurement
    prior: wp.array2d[wp.int32],  # (B, 4) pitch and roll [angle steps], height, valid
    settings: wp.array[wp.int32],  # see native/floor_planes.h
    sines: wp.array[wp.int32],  # from -360 degrees on, by angle steps
    found_out: wp.array2d[wp.int32],  # (B, 8)
):
    """The best plane of each frame; :func:`floor_scratch_words` of scratch memory.

    What is found is pitch, roll and height, start and turn of its ramp (turn 0 = none), cells on
    it, all cells, refusal.
    """


@team_kernel(
    "found_frame.h",
    body="""
        const int at = b * FloorFrame::VALUES;
        if (team.rank == 0)
            FoundFrame{{sines.data}}.run(found.data + b * FoundFrame::RESULTS, given.data + at,
                                         frame_out.data + at);
""",
    launch_bounds=(_WARP, 16),
)
def found_frame(
    found: wp.array2d[wp.int32],  # (B, 8) from the kernel floor
    given: wp.array2d[wp.int32],  # (B, 13) frames of floors for where none was found
    sines: wp.array[wp.int32],  # as in floor
    frame_out: wp.array2d[wp.int32],  # (B, 13) frames of the own floors
):
    """Frames are as :data:`jaxdet.floor.frame.FLOOR_VALUES` says."""
