"""All five stages as one compiled program, where the device has one for the cameras."""

from jaxdet.config import Config
from jaxdet.stages import _program, _program_cpu
from jaxdet.stages._device import on_cuda
from jaxdet.stages._features import check_kernels_size
from jaxdet.types import Detections, Frames, GroundPlane


def covers(frames: Frames) -> bool:
    """Whether these frames run as one program: on the CPU, not where lenses are distorted."""
    return on_cuda() or _program_cpu.covers(frames.calibration)


def detect(frames: Frames, plane: GroundPlane, config: Config) -> Detections:
    """Runs the five stages as one program.

    Args:
        frames: ``B`` frames that :func:`covers` is true for.
        plane: The floor of each frame.
        config: The method's parameters.

    Returns:
        What :func:`jaxdet.pipeline.detect` returns, still being computed perhaps.

    Raises:
        ConfigError: The kernels don't take the colour images' size.
    """
    check_kernels_size(frames.calibration.color)
    program = _program if on_cuda() else _program_cpu
    return program.detect(frames, plane, config)
