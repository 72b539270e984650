"""XLA's C interface of custom calls, as far as kernels on the CPU need it.

Source: ``xla/ffi/api/c_api.h``, version 0.1. :func:`warp.jax_kernel` has all of it, and makes out
shapes, strides and types at every call, which takes longer than many a kernel; here they are known
since the program was traced, and a call is the addresses of its buffers.
"""

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

_SIZE, _POINTER, _INT = ctypes.c_size_t, ctypes.c_void_p, ctypes.c_int
_METADATA = 1
"""Type of the extension by which XLA asks for the version."""
_UNKNOWN = 2
"""Code of an error."""


def _struct(*fields: tuple[str, Any]) -> Any:
    return type("_Struct", (ctypes.Structure,), {"_fields_": [("struct_size", _SIZE), *fields]})


_HEAD = ("extension", _POINTER)
_Version = _struct(_HEAD, ("major", _INT), ("minor", _INT))
_Extension = _struct(("type", _INT), ("next", _POINTER), ("metadata", _POINTER))
_Metadata = _struct(("version", _Version), ("traits", ctypes.c_uint32))
_Buffer = _struct(_HEAD, ("dtype", _INT), ("data", _POINTER))
_LIST = _HEAD, ("size", ctypes.c_int64), ("types", _POINTER)
_Buffers = _struct(*_LIST, ("items", _POINTER))
_Attributes = _struct(*_LIST, ("names", _POINTER), ("items", _POINTER))
_Error = _struct(_HEAD, ("message", ctypes.c_char_p), ("code", _INT))
_CREATE_ERROR = ctypes.CFUNCTYPE(_POINTER, ctypes.POINTER(_Error))
_Api = _struct(_HEAD, ("version", _Version), ("internal", _POINTER), ("create", _CREATE_ERROR))
_CALL = _HEAD, ("api", _POINTER), ("context", _POINTER), ("stage", _INT)
_PARTS = ("arguments", _Buffers), ("results", _Buffers), ("attributes", _Attributes)
_Frame = _struct(*_CALL, *_PARTS)


class _Scalar(ctypes.Structure):
    _fields_ = [("dtype", _INT), ("value", _POINTER)]


_DATA = _Buffer.data.offset
_Handler = ctypes.CFUNCTYPE(_POINTER, _POINTER)
_handlers: list[Any] = []
"""What XLA has the addresses of."""


def register(name: str, run: Callable[[int, list[int]], None]) -> None:
    """Registers a custom call of the CPU.

    Args:
        name: What :func:`jax.ffi.ffi_call` calls it; :func:`called` has the rest.
        run: Gets the number of the call and the addresses of its inputs and then its outputs. What
            it raises is raised where results are waited for.
    """

    def handle(address: int) -> int | None:
        frame = _Frame.from_address(address)
        try:
            if frame.extension:
                _tell_version(frame.extension)
                return None
            scalar = _Scalar.from_address(_addresses(frame.attributes)[0])
            number = ctypes.c_int64.from_address(scalar.value).value
            buffers = [*_addresses(frame.arguments), *_addresses(frame.results)]
            run(number, [_POINTER.from_address(buffer + _DATA).value or 0 for buffer in buffers])
        except BaseException as error:  # of a Ctrl-C too: ctypes would drop it
            message = f"{name}: {type(error).__name__}: {error}".encode()
            made = _Error(ctypes.sizeof(_Error), None, message, _UNKNOWN)
            return _Api.from_address(frame.api).create(ctypes.byref(made))
        return None

    handler = _Handler(handle)
    _handlers.append(handler)
    address = ctypes.cast(handler, _POINTER).value
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(address), platform="cpu")


def _addresses(of: Any) -> list[int]:
    return list((ctypes.c_size_t * of.size).from_address(of.items)) if of.size else []


def _tell_version(address: int) -> None:
    extension = _Extension.from_address(address)
    if extension.type == _METADATA:
        version = _Metadata.from_address(extension.metadata).version
        version.major, version.minor = 0, 1


def called(
    name: str,
    number: int,
    arguments: Sequence[Any],
    results: Sequence[jax.ShapeDtypeStruct],
) -> Sequence[jax.Array]:
    """The results of a custom call, under ``jax.jit``.

    Args:
        name: Registered.
        number: For the function there, 64 bits.
        arguments: Arrays.
        results: Their shapes and types.
    """
    return jax.ffi.ffi_call(name, results)(*arguments, number=np.int64(number))
