"""What stands in for CuPy where there is no GPU: NumPy arrays, and the kernels' own text compiled by g++."""

import ctypes
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.common.geometry import Array

FRAME = Path(__file__).with_name("cuda_on_cpu.cpp")
COMPILER = shutil.which("g++")


class DeviceArray(np.ndarray):
    """An array "on the GPU": kernels take no other, and plain ones come of `asnumpy` alone."""


class CompiledModule:
    """`cupy.RawModule`: what is the same for nvrtc and g++ of its options is passed on."""

    def __init__(self, *, code: str, options: Sequence[str]) -> None:
        assert COMPILER is not None
        # g++ fuses products with sums unless told otherwise, as nvrtc does.
        assert "--fmad=false" in options
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "kernel_text.h").write_text(code)
            library = Path(folder, "kernels.so")
            defines = [option for option in options if option.startswith("-D")]
            flags = ["-O1", "-std=c++17", "-w", "-ffp-contract=off", "-shared", "-fPIC", f"-I{folder}"]
            subprocess.run([COMPILER, *flags, *defines, "-o", str(library), str(FRAME)], check=True)
            self._library = ctypes.CDLL(str(library))
        self._lock = threading.Lock()

    def get_function(self, name: str) -> "Kernel":
        return Kernel(getattr(self._library, f"launch_{name}"), self._lock)


class Kernel:
    """`cupy.RawKernel`: arrays by their memory, scalars of NumPy by their own type, nothing else."""

    def __init__(self, launch: Any, lock: threading.Lock) -> None:
        self._launch, self._lock = launch, lock

    def __call__(self, grid: tuple[int, ...], block: tuple[int, ...], args: tuple[Any, ...]) -> None:
        assert len(grid) == len(block) == 3
        held: list[Any] = []
        for arg in args:
            if isinstance(arg, DeviceArray):
                assert arg.flags.c_contiguous
                held.append(ctypes.c_void_p(arg.ctypes.data))
            else:
                kinds = {np.int32: ctypes.c_int, np.float32: ctypes.c_float}
                held.append(kinds[type(arg)](arg.item()))
        pointers = (ctypes.c_void_p * len(held))(*(ctypes.addressof(one) for one in held))
        with self._lock:
            assert self._launch(*map(int, grid), *map(int, block), pointers) == 0


class StandIn:
    """The part of CuPy's interface that the sweep uses."""

    RawModule = CompiledModule

    def asarray(self, array: Any, dtype: Any = None) -> Array:
        return np.array(array, dtype).view(DeviceArray)

    def empty(self, shape: tuple[int, ...], dtype: Any) -> Array:
        return np.empty(shape, dtype).view(DeviceArray)

    def zeros(self, shape: tuple[int, ...], dtype: Any) -> Array:
        return np.zeros(shape, dtype).view(DeviceArray)

    def concatenate(self, arrays: Sequence[Array]) -> Array:
        assert all(isinstance(array, DeviceArray) for array in arrays)
        return np.concatenate(arrays).view(DeviceArray)

    def asnumpy(self, array: Array) -> Array:
        assert isinstance(array, DeviceArray)
        return np.array(array)
