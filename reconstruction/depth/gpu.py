"""Sweep engine for NVIDIA GPUs: CuPy runs the cost and semi-global scan kernels of `kernels.cu`."""

import importlib
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from weakref import ref

import numpy as np

from capture_app.common.errors import NotAvailableError
from capture_app.common.text import first_line
from capture_app.console.terminal import talk
from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import OUTSIDE, SourceView
from reconstruction.depth.compiled import CPU
from reconstruction.depth.cost_volume import BETTER_OF_TWO, WORST_COST
from reconstruction.depth.sweep_engine import SweepEngine

KERNELS = Path(__file__).with_name("kernels.cu")
TILE, DEPTHS = (32, 8), 16
WARP = 32
SCAN_THREADS = 64
CHOICE_THREADS = 128


@dataclass(frozen=True, eq=False)
class GpuVolume:
    """Costs on the GPU (height x width x depths, uint8); depths beyond `count` pad to a multiple of 4."""

    costs: Any
    count: int


@contextmanager
def _gpu_errors() -> Iterator[None]:
    """Convert any GPU failure into NotAvailableError; CuPy's errors have no common base."""
    try:
        yield
    except Exception as error:
        hint = "CUDA_VISIBLE_DEVICES= (empty) keeps to the CPU"
        raise NotAvailableError(f"the GPU failed: {first_line(error)}", hint=hint) from error


class GpuEngine(SweepEngine):
    """Engine of the sweep on the current CUDA device; `cupy` is the module, or one with its interface."""

    # Plane fits, votes and warps along a surface run on the CPU.
    fit_planes = staticmethod(CPU.fit_planes)
    warp = staticmethod(CPU.warp)
    compare = staticmethod(CPU.compare)

    def __init__(self, cupy: Any, note: str = "") -> None:
        super().__init__(note)
        self._cupy = cupy
        self._uploads: dict[int, tuple[ref[Array], Any]] = {}
        self._lock = threading.Lock()
        self._compiled = cache(self._compile)

    @_gpu_errors()
    def cost_volume(
        self, source_views: Sequence[SourceView], base: Array | None, offsets: Array
    ) -> GpuVolume:
        """Compute costs as the CPU's `cost_volume`, except for rounding."""
        xp = self._cupy
        reference = source_views[0].reference
        height, width = reference.grey.shape
        pictures = [one.source.grey for one in source_views]
        begins = np.cumsum([0, *(picture.size for picture in pictures[:-1])])
        info = [(begin, p.shape[1], p.shape[0]) for begin, p in zip(begins, pictures, strict=True)]
        numbers = np.concatenate([one.numbers for one in source_views])
        count = len(offsets)
        padded = -(-count // 4) * 4
        out = xp.empty((height, width, padded), np.uint8)
        grid = tuple(-(-size // of) for size, of in ((width, TILE[0]), (height, TILE[1]), (padded, DEPTHS)))
        self._kernel("costs", half_window=reference.window // 2)(
            grid,
            (*TILE, 1),
            (
                self._upload(reference.grey),
                self._upload(reference.mean),
                self._upload(reference.deviation),
                xp.zeros((height, width), np.float32) if base is None else self._copy(base),
                xp.asarray(offsets, np.float32),
                np.int32(count),
                xp.concatenate([self._upload(picture).reshape(-1) for picture in pictures]),
                xp.asarray(info, np.int32),
                xp.asarray(numbers, np.float32),
                np.int32(len(source_views)),
                np.int32(height),
                np.int32(width),
                np.int32(padded),
                np.float32(OUTSIDE),
                np.float32(BETTER_OF_TWO),
                out,
            ),
        )
        return GpuVolume(out, count)

    @_gpu_errors()
    def find_cheapest(self, volume: GpuVolume, grey: Array, small: int, large: int) -> tuple[Array, Array]:
        """Find the cheapest depths, bit-identical to the CPU's."""
        xp = self._cupy
        height, width, padded = volume.costs.shape
        depths, lanes = _lanes(padded)
        total = xp.zeros((height, width, padded), np.int16)
        warps = -(-(height + width - 1) // (WARP // lanes))
        sizes = (np.int32(size) for size in (height, width, volume.count, padded, lanes, small, large))
        self._kernel("scan", lane_depths=depths)(
            (-(-warps * WARP // SCAN_THREADS), 8, 1),
            (SCAN_THREADS, 1, 1),
            (volume.costs, total, self._upload(grey), *sizes),
        )
        place, own = (xp.empty((height, width), np.float32) for _ in range(2))
        sizes = (np.int32(size) for size in (height * width, volume.count, padded))
        self._kernel("cheapest")(
            (-(-height * width // CHOICE_THREADS), 1, 1),
            (CHOICE_THREADS, 1, 1),
            (volume.costs, total, *sizes, place, own),
        )
        return xp.asnumpy(place), xp.asnumpy(own)

    def costs_along(self, source_views: Sequence[SourceView], inverse_depth: Array) -> Array:
        """Compute costs along a surface as on the CPU, except for rounding."""
        volume = self.cost_volume(source_views, inverse_depth, np.zeros(1))
        with _gpu_errors():
            return np.ascontiguousarray(self._cupy.asnumpy(volume.costs)[..., 0])

    def _copy(self, array: Array) -> Any:
        """Copy an array to the GPU in row-major order, as kernels expect; CuPy would keep its order here."""
        return self._cupy.asarray(np.ascontiguousarray(array, np.float32))

    def _kernel(self, name: str, *, half_window: int = 2, lane_depths: int = 4) -> Any:
        with self._lock:
            return self._compiled(half_window, lane_depths).get_function(name)

    def _compile(self, half_window: int, lane_depths: int) -> Any:
        options = f"-DR={half_window}", f"-DLV={lane_depths}", "--fmad=false"
        return self._cupy.RawModule(code=KERNELS.read_text(), options=options)

    def _upload(self, array: Array) -> Any:
        """Return an array's copy on the GPU, uploaded once during the array's lifetime."""
        with self._lock:
            known = self._uploads.get(id(array))
            if known is not None and known[0]() is array:
                return known[1]
            self._uploads = {key: held for key, held in self._uploads.items() if held[0]() is not None}
            there = self._copy(array)
            self._uploads[id(array)] = ref(array), there
            return there


def on_cpu(why: str) -> SweepEngine:
    """Return the CPU's engine with a note that says why no GPU is used."""
    engine = copy(CPU)
    engine.note = "; ".join(filter(None, (f"on the CPU: {why}", CPU.note)))
    return engine


def use_gpu(cupy: Any) -> SweepEngine:
    """Return the first GPU's engine if it passes a test, else the CPU's; `cupy` is the module."""
    try:
        if not cupy.cuda.runtime.getDeviceCount():
            return on_cpu("CuPy finds no GPU")
        name = cupy.cuda.runtime.getDeviceProperties(0)["name"].decode()
        engine = GpuEngine(cupy, f"on {name}")
        costs = np.full((4, 4, 4), WORST_COST, np.uint8)
        costs[..., 2] = 0
        place, _ = engine.find_cheapest(GpuVolume(cupy.asarray(costs), 4), np.zeros((4, 4), np.float32), 1, 2)
    # No driver, an old driver, no compiler, no free memory.
    except Exception as error:  # noqa: BLE001
        cause = error.__cause__ if isinstance(error, NotAvailableError) else error
        said = first_line(cause if isinstance(cause, Exception) else error)
        return on_cpu(f"the GPU cannot be used ({said})")
    if not (place == 2).all():
        return on_cpu(f"{name} computes wrongly")
    return engine


@cache
def find_engine() -> SweepEngine:
    """Return a GPU's engine if CuPy and a GPU are available, else the CPU's; searched and reported once."""
    try:
        engine = use_gpu(importlib.import_module("cupy"))
    except ImportError:
        engine = CPU
    # A CuPy built for another NumPy, or without its libraries, may raise anything.
    except Exception as error:  # noqa: BLE001
        engine = on_cpu(f"CuPy is broken ({first_line(error)})")
    if engine.note:
        talk(f"depth {engine.note}")
    return engine


def _lanes(padded: int) -> tuple[int, int]:
    """Return the depths per lane of a path, and the lanes per path (a power of two)."""
    depths = 4 * max(1, -(-padded // (4 * WARP)))
    lanes = 1
    while lanes * depths < padded:
        lanes *= 2
    return depths, lanes
