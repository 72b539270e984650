"""Custom calls of XLA."""

import ctypes

import jax

from jaxdet.stages import _xla


def test_call_with_an_unknown_extension_runs(monkeypatch):
    """XLA may attach extensions of types that are not known here to any call."""
    monkeypatch.setattr(jax.ffi, "register_ffi_target", lambda *_, **__: None)
    monkeypatch.setattr(jax.ffi, "pycapsule", lambda address: address)
    calls = []
    monkeypatch.setattr(_xla, "_number_and_addresses", lambda frame: (7, [1, 2]))
    _xla.register("test.call", lambda *call: calls.append(call))
    extension = _xla._Extension(ctypes.sizeof(_xla._Extension), 99, None, None)
    frame = _xla._Frame(extension=ctypes.addressof(extension))
    assert not _xla._handlers[-1](ctypes.addressof(frame))
    assert calls == [(7, [1, 2])]


def test_request_for_the_version_is_answered_and_runs_nothing(monkeypatch):
    version = _xla._Version()
    metadata = _xla._Metadata(version=version)
    asks = _xla._Extension(0, _xla._METADATA, None, ctypes.addressof(metadata))
    first = _xla._Extension(0, 99, ctypes.addressof(asks), None)
    assert _xla._reported_version(ctypes.addressof(first))
    assert (metadata.version.major, metadata.version.minor) == (0, 1)
