"""Self-check: the stored digest is that of the reference, and kernels that differ are refused."""

import pytest

from jaxdet import detect
from jaxdet.errors import JaxdetError
from jaxdet.runtime.calls import device_of_jax
from jaxdet.stages import _check, _program


def test_the_stored_answer_equals_the_reference() -> None:
    found = detect(_check.check_frames(), backend="reference")
    assert found.num_obstacles.tolist() == [2, 2]
    assert _check.digest(found) == _check.ANSWER


def test_kernels_that_differ_from_the_stored_answer_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _check.check_kernels.cache_clear()
    _check.check_kernels()
    _check.check_kernels.cache_clear()
    monkeypatch.setattr(_check, "ANSWER", "0" * 32)
    device = device_of_jax(_program.kernels)
    with pytest.raises(JaxdetError, match=rf"wrong results with Warp \S+, JAX \S+ on {device};"):
        _check.check_kernels()
