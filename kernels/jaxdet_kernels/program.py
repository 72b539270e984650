"""The method on depth images: a kernel for the CPU that does all steps, one for each step on CUDA.

``include/jaxdet/program.h`` calls the steps; ``jaxdet/stages/_program.py`` makes the arrays.
"""

from typing import Any

import warp as wp

from jaxdet_kernels.build import options

wp.set_module_options(options("program.h"))

WIDTH = 256  # threads of a team on CUDA
Depth = wp.array3d[wp.uint16]
Rows = wp.array2d[wp.int32]
Words = wp.array[wp.int32]
TYPES = Depth, Rows, Words, Rows, Rows, Rows, Rows
"""Of the arrays of a call, those of a step's kernel."""

_BATCH = """
    const jaxdet::Batch batch{
        depth.data, floors.data, tables.data, record.data, contour.data, work.data,
        depth.shape[0], depth.shape[1] * depth.shape[2],
        record.shape[1], contour.shape[1], work.shape[1], rows, columns};
"""


@wp.func_native(f"""
#if !defined(__CUDA_ARCH__)
    {_BATCH}
    batch.by_threads(next.data, first, last, scratch.data);
#endif
""")
def _frames(
    depth: Depth,
    floors: Rows,
    tables: Words,
    record: Rows,
    contour: Rows,
    work: Rows,
    rows: int,
    columns: int,
    first: int,
    last: int,
    scratch: Words,
    next: Words,
): ...


@wp.kernel
def frames(
    depth: Depth,  # (B, Hd, Wd) [depth units], 0 = no measurement
    floors: Rows,  # (B, 17) prior floors, then the floor frames where none is found
    tables: Words,  # header, then the tables of a camera and a configuration
    record: Rows,  # (B, words) results
    contour: Rows,  # (B, M C 2) results, from left to right, right and forward
    work: Rows,  # (B, work_words) what steps hand on, or (1, 1): not kept
    rows: int,  # of the grid of cells
    columns: int,
    first: int,  # step, see STEPS
    last: int,
    scratch: Words,  # what steps hand on, then their scratch memory
    next: Words,
):
    """Takes frames until none is left, on the CPU."""
    _frames(depth, floors, tables, record, contour, work, rows, columns, first, last, scratch, next)


@wp.func_native("""
    int* const none = nullptr;
    const jaxdet::Frame frame(rows, columns, tables.data, nullptr, none, none, none, none);
    words.data[0] = (int)frame.scratch_words(jaxdet::Team(0, 0));
""")
def _scratch_words(tables: Words, rows: int, columns: int, words: Words): ...


@wp.kernel
def scratch_words(tables: Words, rows: int, columns: int, words: Words):
    """Words of scratch memory of a thread or a team; launched by one thread."""
    _scratch_words(tables, rows, columns, words)


def _step(name: str, blocks: int) -> Any:
    """The kernel of a step on CUDA: teams take the frames of a batch in turn."""

    def native(
        tid: int,
        depth: Depth,
        floors: Rows,
        tables: Words,
        record: Rows,
        contour: Rows,
        work: Rows,
        scratch: Rows,
        rows: int,
        columns: int,
        teams: int,
    ): ...

    native.__name__ = native.__qualname__ = f"_{name}"
    snippet = f"""
#if defined(__CUDA_ARCH__)
    {_BATCH}
    batch.by_teams(tid, teams, scratch.data, scratch.shape[1],
        [](const jaxdet::Frame& frame, const jaxdet::Team& team, int* own) {{
            frame.{name}(team, own);
        }});
#endif
"""
    function = wp.func_native(snippet)(native)

    def kernel(
        depth: Depth,
        floors: Rows,
        tables: Words,
        record: Rows,
        contour: Rows,
        work: Rows,
        scratch: Rows,
        rows: int,
        columns: int,
        teams: int,
    ):
        function(
            wp.tid(), depth, floors, tables, record, contour, work, scratch, rows, columns, teams
        )

    return wp.kernel(kernel, name=name, launch_bounds=(WIDTH, blocks))


BLOCKS = 4
"""Blocks that are on a multiprocessor of CUDA at once: a thread has up to 64 registers."""

STEPS = {
    name: _step(name, BLOCKS)
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
"""Kernels in the order in which they run; on CUDA, where :func:`frames` does nothing."""
