"""Complete method as one compiled program, for the CPU and CUDA."""

from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxdet.config import Config
from jaxdet.runtime.calls import device_of_jax, jax_callable, most_teams, uninterrupted
from jaxdet.stages import _batches, _program, paper
from jaxdet.stages._check import check_kernels
from jaxdet.stages._program import Rows, Static
from jaxdet.types import Calibration, Detections, Frames, GroundPlane
from jaxdet_kernels import program as kernels


def detect(
    frames: Frames, plane: GroundPlane, config: Config, with_cells: bool = False
) -> Detections:
    """Detect obstacles; twin of :func:`jaxdet.reference.detect`.

    Args:
        frames: ``B`` frames; images on the host or already on a device. On the CPU, images whose
            memory is aligned to 64 bytes are read in place; do not modify them until the results
            are ready.
        plane: Prior of the floor in each frame.
        config: Configuration of the method.
        with_cells: Whether to return the labels of cells as well.

    Returns:
        The obstacles; JAX may still be computing them.

    Raises:
        ConfigError: The kernels do not support images or grids of this size.
    """
    if config.cluster.points:
        return paper.detect(frames, plane, config)
    tables, static = _tables(frames.calibration, config)

    def run(images: tuple[Any, ...], planes: GroundPlane) -> Detections:
        inputs = tables, _program.floors(planes, config, frames.calibration.depth_unit)
        return uninterrupted(_detect, *images, inputs, static, with_cells)

    found = _batches.in_parts(run, (frames.depth,), plane)
    assert found.scene is not None
    return found._replace(scene=found.scene._replace(prior=plane))


@lru_cache(maxsize=8)
def _tables(calibration: Calibration, config: Config) -> tuple[jax.Array, Static]:
    """Return the tables on the device, and the sizes that a program is compiled for."""
    check_kernels()
    device = device_of_jax(kernels)
    packed = _program.packed_tables(calibration, config, str(device))
    return jnp.asarray(packed), Static.of(packed)


@partial(jax.jit, static_argnames=("static", "with_cells"))
def _detect(
    depth: jax.Array,
    inputs: tuple[jax.Array, jax.Array],
    static: Static,
    with_cells: bool,
) -> Detections:
    tables, floors = inputs
    rows = _run_steps(depth, floors, tables, static, with_cells)
    return _program.detections(rows, static, with_cells, jnp)


def _run_steps(
    depth: jax.Array, floors: jax.Array, tables: jax.Array, static: Static, keep_work: bool
) -> Rows:
    """Run all steps on a batch, under ``jax.jit``.

    Args:
        depth: Depth images ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement.
        floors: Priors ``(B, 17)`` int32, from :func:`jaxdet.stages._program.floors`.
        tables: Header and tables, from :func:`jaxdet.stages._program.packed`.
        static: Sizes that the program is compiled for.
        keep_work: Whether to return the intermediate arrays.
    """
    batch, program = len(depth), _compiled(static, keep_work)

    def call(work: bool, scratch: tuple[int, int]) -> Rows:
        record, contour, words = static.words(work)
        dims = {"record": (batch, record), "contour": (batch, contour), "scratch": scratch}
        dims["work"] = (batch, words) if work else (1, 1)
        return Rows(*program(depth, floors, tables, output_dims=dims)[:3])

    def on_cuda() -> Rows:
        teams = most_teams(batch, static.own_words)
        found = call(True, (teams, static.own_words))
        return found if keep_work else found._replace(work=found.work[:1, :1])

    return jax.lax.platform_dependent(cpu=lambda: call(keep_work, (1, 1)), cuda=on_cuda)


@lru_cache(maxsize=64)
def _compiled(static: Static, keep_work: bool) -> Any:
    """Return a function for ``jax.jit`` that runs all steps of the program."""
    steps = len(_program.STEPS)

    def program(
        depth: Any, floors: Any, tables: Any, record: Any, contour: Any, work: Any, scratch: Any
    ) -> None:
        _program.launch([depth, floors, tables, record, contour, work], scratch, 0, steps, static)

    program.__qualname__ = "_".join(map(str, ("steps", *static, keep_work)))
    return jax_callable(kernels, kernels.TYPES, outputs=4)(program)
