"""The floor of each frame. Twin of ``_find`` in ``jaxdet/reference/_floor.py``."""

import warp as wp

from jaxdet_kernels.native_source import CPU_FLAGS, native_kernel

wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": CPU_FLAGS})

_DIRECTIONS = 30 * 21
"""Without a prior."""
_NEAR_DIRECTIONS = 17 * 9
_FIXED_WORDS = 2048
"""More than all that does not grow with the frame or the lattices."""
_WARP = 32
WIDTH = 256
"""Threads of a team on CUDA."""
_BLOCKS = 4
"""On a multiprocessor at once: a thread has up to 64 registers."""
_COPIES = 8


def floor_scratch_words(
    *, rows: int, columns: int, near_bins: int, wide_bins: int, runs: int, rises: int, width: int
) -> int:
    """32-bit words of scratch memory of a team, even, see ``native/floor.h``.

    Args:
        rows: Of the cells that are used.
        columns: Of these.
        near_bins: Heights tried near a guess.
        wide_bins: Heights tried without a prior.
        runs: Distances of a profile of the floor.
        rises: Its heights.
        width: Threads of a team.
    """
    cells, few = rows * columns, -(-rows // 2) * -(-columns // 2)
    weights = max(-(-width // _WARP) * few, cells)
    near, wide = (-(-n // _WARP) * _WARP for n in (_NEAR_DIRECTIONS, _DIRECTIONS))
    lattice = max(near * (near_bins + 1), wide * (wide_bins + 1))
    table = max(lattice, runs * (rises + 1))
    copies = _COPIES * (max(near_bins, wide_bins) + 1)
    words = _FIXED_WORDS + 6 * cells + 11 * few + weights + 8 * (runs + 1) + copies + table
    return words + words % 2


@native_kernel(
    "crew.h",
    "lanes.h",
    "floor_planes.h",
    "floor_search.h",
    "floor_ramp.h",
    "floor.h",
    body="""
    const Team team(tid, share);
    const int batch = z.shape[0], rows = z.shape[1], columns = z.shape[2], cells = rows * columns;
    int* scratch = scratch_out.data + (size_t)team.index * scratch_out.shape[1];
#if defined(__CUDA_ARCH__)
    __shared__ __align__(16) int fast[Floor::SHARED];
#else
    int* const fast = nullptr;
#endif
    for (int b = team.index; b < batch; b += shares) {
        const Floor floor(team, settings.data, sines.data, prior.data + b * Floor::PRIOR, rows,
                          columns, scratch, fast);
        const size_t first = (size_t)b * cells;
        floor.run(x.data + first, y.data + first, z.data + first, rows, columns,
                  found_out.data + b * Floor::RESULTS);
    }
""",
    launch_bounds=(WIDTH, _BLOCKS),
)
def floor(
    tid: int,
    share: int,
    shares: int,
    x: wp.array3d[wp.int32],
    y: wp.array3d[wp.int32],
    z: wp.array3d[wp.int32],
    prior: wp.array2d[wp.int32],
    settings: wp.array[wp.int32],
    sines: wp.array[wp.int32],
    found_out: wp.array2d[wp.int32],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        tid: Of the launch.
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        x: ``(B, R, C)``, colour optical frame [depth units].
        y: Likewise.
        z: Likewise, 0 = no measurement.
        prior: ``(B, 4)``: pitch and roll [angle steps], height [depth units], valid.
        settings: See :class:`jaxdet.stages._floor.FloorSettings`.
        sines: From -360 degrees on, by angle steps.
        found_out: ``(B, 8)``: pitch, roll and height of the best plane, start and turn of its ramp
            (turn 0 = none), cells on it, all cells, refusal.
        scratch_out: ``(teams, words)``, see :func:`floor_scratch_words`.
    """


@native_kernel(
    "crew.h",
    "floor_frame.h",
    "floor_planes.h",
    "found_frame.h",
    body="""
    const Team team(tid, share);
    for (int b = team.index; b < found.shape[0]; b += shares) {
        const int at = b * FloorFrame::VALUES;
        if (team.rank == 0)
            FoundFrame{{sines.data}}.run(found.data + b * FoundFrame::RESULTS, given.data + at,
                                         frame_out.data + at);
    }
""",
    launch_bounds=(_WARP, 16),
)
def found_frame(
    tid: int,
    share: int,
    shares: int,
    found: wp.array2d[wp.int32],
    given: wp.array2d[wp.int32],
    sines: wp.array[wp.int32],
    frame_out: wp.array2d[wp.int32],
    scratch_out: wp.array2d[wp.int32],
):
    """A team of threads takes frames ``share, share + shares, ...``.

    Args:
        tid: Of the launch.
        share: The first of them, of the launch.
        shares: How many teams there are in all.
        found: ``(B, 8)``, from :func:`floor`.
        given: ``(B, 13)``, the frames of floors for where none was found, see
            :data:`jaxdet.floor.frame.FLOOR_VALUES`.
        sines: As in :func:`floor`.
        frame_out: ``(B, 13)``, likewise: of the own floors.
        scratch_out: Not used.
    """
