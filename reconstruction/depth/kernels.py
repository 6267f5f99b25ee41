"""The compiled functions of this folder's C files, loaded at first use and called without the GIL."""

import ctypes
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np

from capture_app.common.errors import NotAvailableError
from reconstruction.common.geometry import Array
from reconstruction.common.worker_pool import computed_once
from reconstruction.depth.compiling import SOURCE, compile_kernels, library_of


@computed_once
def load_kernels(source: Path = SOURCE) -> ctypes.CDLL:
    """Load the kernels compiled from the source; compile them first if they are missing or broken.

    Raises:
        NotAvailableError: they are not compiled, and cannot be.
    """
    library = library_of(source)
    for compiled in (library.exists, partial(compile_kernels, source)):
        with suppress(OSError):
            if compiled():
                return ctypes.CDLL(str(library))
    raise NotAvailableError(
        "depth from several cameras needs kernels that are not compiled for this machine",
        hint="install a C compiler (Debian: gcc libc6-dev), then simulshot again",
    )


def call_kernel(name: str, *args: object, source: Path = SOURCE) -> None:
    """Call a kernel of a source file; arrays are passed by pointer and must be contiguous."""
    given = [ctypes.c_void_p(arg.ctypes.data) if isinstance(arg, np.ndarray) else arg for arg in args]
    if load_kernels(source)[name](*given):
        raise MemoryError(f"no memory left for the matching ({name})")


def floats(array: Array) -> Array:
    """Return an array as contiguous float32."""
    return np.ascontiguousarray(array, np.float32)
