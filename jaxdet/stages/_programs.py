"""All five stages as one compiled program, where the device has one for the settings."""

from types import ModuleType

from jaxdet.config import Config
from jaxdet.stages import _program, _program_cpu
from jaxdet.stages._device import on_cuda
from jaxdet.types import Detections, Frames, GroundPlane


def covers(frames: Frames, config: Config) -> bool:
    """Whether these frames run as one program."""
    return _own().covers(frames, config)


def detect(frames: Frames, plane: GroundPlane, config: Config) -> Detections:
    """Runs the five stages as one program.

    Args:
        frames: ``B`` frames that :func:`covers` is true for.
        plane: The floor of each frame.
        config: The method's parameters.

    Returns:
        What :func:`jaxdet.pipeline.detect` returns, still being computed perhaps.
    """
    return _own().detect(frames, plane, config)


def _own() -> ModuleType:
    return _program if on_cuda() else _program_cpu
