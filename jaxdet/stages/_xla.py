"""XLA's C interface of custom calls, as far as kernels need it.

Source: ``xla/ffi/api/c_api.h``, version 0.1. :func:`warp.jax_kernel` has all of it, and makes out
shapes, strides and types at every call, which takes longer than many a kernel; here they are known
since the program was traced, and a call is the addresses of its buffers.
"""

import ctypes
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from hashlib import blake2b
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
_OfContext = _struct(_HEAD, ("context", _POINTER), ("value", _POINTER))
_GET = ctypes.CFUNCTYPE(_POINTER, ctypes.POINTER(_OfContext))
_Api = _struct(
    _HEAD,
    ("version", _Version),
    ("internal", _POINTER),
    ("create_error", _CREATE_ERROR),
    ("errors_and_handlers", _POINTER * 3),
    ("stream", _GET),
    ("types_states_memory_threads", _POINTER * 12),
    ("device_ordinal", _GET),
)
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
    _register(name, "cpu", lambda frame: run(*_number_and_addresses(frame)))


def register_cuda(name: str, run: Callable[[int, list[int], int, int], None]) -> None:
    """Registers a custom call of CUDA.

    Args:
        name: As for :func:`register`.
        run: As for :func:`register`; it also gets the number of the device and the address of the
            stream, on which it launches.
    """

    def launch(frame: Any) -> None:
        api = _Api.from_address(frame.api)
        of_context = partial(_of_context, frame.context)
        device = ctypes.c_int32(of_context(api.device_ordinal)).value
        run(*_number_and_addresses(frame), device, of_context(api.stream))

    _register(name, "CUDA", launch)


def _register(name: str, platform: str, run: Callable[[Any], None]) -> None:
    def handle(address: int) -> int | None:
        frame = _Frame.from_address(address)
        try:
            if not _reported_version(frame.extension):
                run(frame)
        except BaseException as error:  # of a Ctrl-C too: ctypes would drop it
            message = f"{name}: {type(error).__name__}: {error}".encode()
            made = _Error(ctypes.sizeof(_Error), None, message, _UNKNOWN)
            return _Api.from_address(frame.api).create_error(ctypes.byref(made))
        return None

    handler = _Handler(handle)
    _handlers.append(handler)
    address = ctypes.cast(handler, _POINTER).value
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(address), platform=platform)


def _number_and_addresses(frame: Any) -> tuple[int, list[int]]:
    scalar = _Scalar.from_address(_addresses(frame.attributes)[0])
    number = ctypes.c_int64.from_address(scalar.value).value
    buffers = [*_addresses(frame.arguments), *_addresses(frame.results)]
    return number, [_POINTER.from_address(buffer + _DATA).value or 0 for buffer in buffers]


def _of_context(context: int, get: Any) -> int:
    """What a function of the interface says of a call's context; zero is the null pointer too."""
    asked = _OfContext(ctypes.sizeof(_OfContext), None, context, None)
    get(ctypes.byref(asked))
    return asked.value or 0


def _addresses(of: Any) -> list[int]:
    return list((ctypes.c_size_t * of.size).from_address(of.items)) if of.size else []


def _reported_version(address: int | None) -> bool:
    """Report the API version if XLA requests it with a metadata extension.

    Args:
        address: The first extension of a call frame, or None. Extensions of other types are
            ignored: such a frame is a call, and its kernel must run.

    Returns:
        Whether the frame is such a request instead of a call.
    """
    while address:
        extension = _Extension.from_address(address)
        if extension.type == _METADATA:
            version = _Metadata.from_address(extension.metadata).version
            version.major, version.minor = 0, 1
            return True
        address = extension.next
    return False


def number_of(call: Any) -> int:
    """A number for a call by its ``repr``: in all processes alike, as programs are kept on disk."""
    return int.from_bytes(blake2b(repr(call).encode(), digest_size=7).digest(), "big")


def called(
    name: str,
    number: int,
    arguments: Sequence[Any],
    results: Sequence[jax.ShapeDtypeStruct],
    changed: Mapping[int, int] | None = None,
) -> tuple[jax.Array, ...]:
    """The results of a custom call, under ``jax.jit``.

    Args:
        name: Registered.
        number: For the function there, 64 bits.
        arguments: Arrays.
        results: Their shapes and types.
        changed: Arguments that are changed in place, each with the result that it becomes.
    """
    call = jax.ffi.ffi_call(name, results, input_output_aliases=dict(changed or {}))
    return tuple(call(*arguments, number=np.int64(number)))
