"""Method on depth images: one kernel with all steps for the CPU, one kernel per step for CUDA.

``include/jaxdet/program.h`` calls the steps; ``jaxdet/stages/_program.py`` allocates the arrays.
"""

from typing import Any

import warp as wp

from jaxdet_kernels.build import BLOCKS, WIDTH, options

wp.set_module_options(options("program.h"))

Depth = wp.array3d[wp.uint16]
Rows = wp.array2d[wp.int32]
Words = wp.array[wp.int32]
TYPES = Depth, Rows, Words, Rows, Rows, Rows, Rows
"""Types of the arrays of a call: those of a batch, and scratch memory."""


@wp.struct
class Batch:
    """Arrays of a batch of frames, and the size of the grid of cells."""

    depth: Depth  # (B, Hd, Wd) [depth units], 0 = no measurement
    floors: Rows  # (B, 17) prior floors, then the floor frames used if no floor is found
    tables: Words  # header, then the tables for a camera and a configuration
    record: Rows  # (B, words) records of results
    contour: Rows  # (B, M C 2) contours from left to right, right and forward
    work: Rows  # (B, work_words) intermediate arrays, or (1, 1) if they are not kept
    rows: int  # rows of the grid of cells
    columns: int  # columns of the grid


_BATCH = """
    const jaxdet::Batch frames{
        batch.depth.data, batch.floors.data, batch.tables.data, batch.record.data,
        batch.contour.data, batch.work.data, batch.depth.shape[0],
        batch.depth.shape[1] * batch.depth.shape[2], batch.record.shape[1],
        batch.contour.shape[1], batch.work.shape[1], batch.rows, batch.columns};
"""


@wp.func_native(f"""
#if !defined(__CUDA_ARCH__)
    {_BATCH}
    frames.by_threads(next.data, first, last, scratch.data);
#endif
""")
def _frames(batch: Batch, first: int, last: int, scratch: Words, next: Words): ...


@wp.kernel
def frames(
    batch: Batch,
    first: int,  # index of the first step, see STEPS
    last: int,  # index of the last step
    scratch: Words,  # intermediate arrays, then scratch memory
    next: Words,  # (1,) index of the first frame that no thread has taken
):
    """Run steps on frames until no frame is left, on the CPU."""
    _frames(batch, first, last, scratch, next)


@wp.func_native("""
    int* const none = nullptr;
    const jaxdet::Frame frame(rows, columns, tables.data, nullptr, none, none, none, none);
    words.data[0] = (int)frame.scratch_words(jaxdet::Team(0, 0));
""")
def _scratch_words(tables: Words, rows: int, columns: int, words: Words): ...


@wp.kernel
def scratch_words(tables: Words, rows: int, columns: int, words: Words):
    """Write the number of scratch words per thread or team; launched with one thread."""
    _scratch_words(tables, rows, columns, words)


def _step(name: str) -> Any:
    """Return the CUDA kernel of a step; the frames of a batch are assigned to teams in turn."""

    def native(tid: int, batch: Batch, scratch: Rows, teams: int): ...

    native.__name__ = native.__qualname__ = f"_{name}"
    snippet = f"""
#if defined(__CUDA_ARCH__)
    {_BATCH}
    frames.by_teams(tid, teams, scratch.data, scratch.shape[1],
        [](const jaxdet::Frame& frame, const jaxdet::Team& team, int* own) {{
            frame.{name}(team, own);
        }});
#endif
"""
    function = wp.func_native(snippet)(native)

    def kernel(batch: Batch, scratch: Rows, teams: int):
        function(wp.tid(), batch, scratch, teams)

    return wp.kernel(kernel, name=name, launch_bounds=(WIDTH, BLOCKS))


STEPS = {
    name: _step(name)
    for name in (
        "find_cells",
        "find_floor",
        "find_frame",
        "find_surfaces",
        "find_obstacles",
        "find_free_floor",
        "find_outlines",
    )
}
"""CUDA kernels of the steps, in the order in which they run; on the CPU :func:`frames` runs all
steps."""
