"""Host functions inside compiled programs that JAX's persistent cache keeps.

`jax.pure_callback` puts an address of its process into a program, which therefore is compiled at
each start. A target of XLA's foreign function interface has a name instead. The interface is C:
the structures below are those of `xla/ffi/api/c_api.h` (version 0.3, Apache 2.0), which jaxlib
ships, read by `ctypes` up to the fields that are needed.
"""

import ctypes
import math
import threading
from collections.abc import Callable, Sequence

import jax
import numpy as np
from jaxtyping import Array

HostFunction = Callable[[Sequence[np.ndarray], Sequence[np.ndarray]], None]
"""Called with views of arguments, which it may not change, and of results, which it fills."""

_DTYPES = {1: np.bool_, 4: np.int32, 8: np.uint32, 11: np.float32}
"""XLA_FFI_DataType."""

_METADATA = 1  # XLA_FFI_Extension_Metadata
_INTERNAL = 13  # XLA_FFI_Error_Code_INTERNAL

_LOCK = threading.Lock()
_HANDLERS: dict[str, object] = {}
"""What XLA calls by name; it never forgets one."""


class _Version(ctypes.Structure):
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("extension", ctypes.c_void_p),
        ("major", ctypes.c_int),
        ("minor", ctypes.c_int),
    )


class _Metadata(ctypes.Structure):
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("version", _Version),
        ("traits", ctypes.c_uint32),
    )


class _Extension(ctypes.Structure):
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("type", ctypes.c_int),
        ("next", ctypes.c_void_p),
        ("metadata", ctypes.POINTER(_Metadata)),  # of an extension of that type
    )


class _Error(ctypes.Structure):
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("extension", ctypes.c_void_p),
        ("message", ctypes.c_char_p),
        ("code", ctypes.c_int),
    )


class _Api(ctypes.Structure):
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("extension", ctypes.c_void_p),
        ("version", _Version),
        ("internal", ctypes.c_void_p),
        ("create_error", ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(_Error))),
    )


class _Buffer(ctypes.Structure):
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("extension", ctypes.c_void_p),
        ("dtype", ctypes.c_int),
        ("data", ctypes.c_void_p),
        ("rank", ctypes.c_int64),
        ("dims", ctypes.POINTER(ctypes.c_int64)),
    )

    def view(self) -> np.ndarray:
        """Returns the buffer as an array, without a copy."""
        shape, dtype = tuple(self.dims[: self.rank]), np.dtype(_DTYPES[self.dtype])
        size = math.prod(shape) * dtype.itemsize
        memory = (ctypes.c_char * size).from_address(self.data or 0)
        return np.ndarray(shape, dtype, memoryview(memory))


class _Buffers(ctypes.Structure):
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("extension", ctypes.c_void_p),
        ("size", ctypes.c_int64),
        ("types", ctypes.c_void_p),
        ("buffers", ctypes.POINTER(ctypes.POINTER(_Buffer))),
    )

    def views(self) -> list[np.ndarray]:
        """Returns all of them as arrays."""
        return [pointer.contents.view() for pointer in self.buffers[: self.size]]


class _Frame(ctypes.Structure):
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("extension", ctypes.POINTER(_Extension)),
        ("api", ctypes.POINTER(_Api)),
        ("context", ctypes.c_void_p),
        ("stage", ctypes.c_int),
        ("arguments", _Buffers),
        ("results", _Buffers),
    )


_HANDLER = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(_Frame))


def call(
    name: str,
    function: HostFunction,
    results: Sequence[jax.ShapeDtypeStruct],
    arguments: Sequence[Array],
) -> Sequence[Array]:
    """Calls a registered function from inside a JAX program; batches come with leading axes.

    Args:
      name: of the function.
      function: itself, for platforms other than the CPU, which compile at each start.
      results: what it fills.
      arguments: what it is given.
    """

    def on_cpu(*arguments: Array) -> Sequence[Array]:
        return jax.ffi.ffi_call(name, results, vmap_method="broadcast_all")(*arguments)

    def elsewhere(*arguments: Array) -> Sequence[Array]:
        return jax.pure_callback(called, results, *arguments, vmap_method="broadcast_all")

    def called(*arguments: Array) -> Sequence[np.ndarray]:
        # Batched by the leading axes that the arguments have beyond those of a single call.
        lead = arguments[0].shape[: arguments[0].ndim - single]
        filled = [np.empty((*lead, *result.shape), result.dtype) for result in results]
        function([np.asarray(argument) for argument in arguments], filled)
        return filled

    single = arguments[0].ndim
    return jax.lax.platform_dependent(*arguments, cpu=on_cpu, default=elsewhere)


def register(name: str, function: HostFunction) -> None:
    """Gives a function the name by which compiled programs `call` it on the CPU.

    Args:
      name: the same in every process that is to share compiled programs; taken once only, later
        functions of the same name are the same function.
      function: what is called, by any thread.
    """
    with _LOCK:
        if name in _HANDLERS:
            return

        def handle(frame: "ctypes._Pointer[_Frame]") -> int | None:
            return _handle(frame.contents, function)

        handler = _HANDLERS[name] = _HANDLER(handle)
        address = ctypes.cast(handler, ctypes.c_void_p)
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(address), platform="cpu")


def _handle(frame: _Frame, function: HostFunction) -> int | None:
    """Answers one call of XLA's: which version this is, or the function itself."""
    if frame.extension and frame.extension.contents.type == _METADATA:
        metadata = frame.extension.contents.metadata.contents
        metadata.version.major, metadata.version.minor, metadata.traits = 0, 3, 0
        return None
    try:
        function(frame.arguments.views(), frame.results.views())
    except BaseException as error:  # None may leave a C function.
        text = f"{type(error).__name__}: {error}".encode()
        created = _Error(ctypes.sizeof(_Error), None, text, _INTERNAL)
        return frame.api.contents.create_error(ctypes.byref(created))
    return None
