"""Sweep engine with the hot loops of `kernels.c`, compiled at installation and called without the GIL."""

import ctypes
import threading
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.depth.calibrated_image import SourceView
from reconstruction.depth.compiling import LIBRARY, source_checksum
from reconstruction.depth.sweep_engine import BETTER_OF_TWO, Agreement, SweepEngine, pad_planes

LANES = 16
"""Columns that `planes` processes at once, and reads beyond the border."""


class _Source(ctypes.Structure):
    _fields_ = (
        ("pixels", ctypes.c_void_p),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("to", ctypes.c_float * 13),
    )


class _Map(ctypes.Structure):
    _fields_ = (
        ("depth", ctypes.c_void_p),
        ("normals", ctypes.c_void_p),
        ("colours", ctypes.c_void_p),
        ("taken", ctypes.c_void_p),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("matrices", ctypes.c_float * 33),
    )


PosedMap = tuple[View, Array, Array, Array]
"""A view, its depth (float32, 0 = none), normals in its frame (float32) and picture (uint8 BGR)."""


class CompiledEngine(SweepEngine):
    """CPU engine of the sweep, from a library of `kernels.c`; equal to NumPy's except for rounding."""

    def __init__(self, library: Path) -> None:
        """Raises OSError or ValueError if the library is missing, or not of this machine and source."""
        super().__init__()
        self._library = ctypes.CDLL(str(library))
        if ctypes.c_int.in_dll(self._library, "source_checksum").value != source_checksum():
            raise ValueError(f"{library} is compiled from another source")
        self._kept = threading.local()

    def cost_volume(self, source_views: Sequence[SourceView], base: Array | None, offsets: Array) -> Array:
        """Compute costs as NumPy's `cost_volume`, except for rounding, valid until the thread's next call."""
        reference = source_views[0].reference
        height, width = reference.grey.shape
        volume = self._reused("volume", (height, len(offsets), width), np.uint8)
        sources = (_Source * len(source_views))(*map(_source, source_views))
        self._call(
            "costs",
            *(height, width, len(offsets), reference.window // 2, len(sources)),
            *map(_floats, (reference.grey, reference.mean, reference.deviation)),
            None if base is None else _floats(base),
            _floats(offsets),
            sources,
            ctypes.c_float(BETTER_OF_TWO),
            volume,
        )
        return volume

    def warp(self, source_view: SourceView, inverse_depth: Array) -> Array:
        """Warp as NumPy's engine, which rounds positions to 1/32 pixel."""
        out = np.empty(inverse_depth.shape, np.float32)
        self._call("warp", *out.shape, _floats(inverse_depth), ctypes.byref(_source(source_view)), out)
        return out

    def splat(self, source_view: SourceView, depth: Array, nearest: Array) -> None:
        """Splat depth, bit-identical to NumPy's."""
        shown = _floats(depth), _floats(source_view.numbers)
        self._call("splat", *depth.shape, *shown, *nearest.shape, nearest)

    def find_cheapest(self, volume: Array, grey: Array, small: int, large: int) -> tuple[Array, Array]:
        """Find the cheapest depths, bit-identical to NumPy's."""
        place, own = (np.empty(grey.shape, np.float32) for _ in range(2))
        self._scan(volume, grey, small, large, place, own)
        return place, own

    def aggregate(self, costs: Array, grey: Array, small: int, large: int) -> Array:
        """Aggregate costs, bit-identical to NumPy's `aggregate_costs`, valid until the thread's next scan."""
        return self._scan(costs, grey, small, large, None, None)

    def _scan(self, volume: Array, grey: Array, small: int, large: int, *found: Array | None) -> Array:
        height, depths, width = volume.shape
        total = self._reused("total", volume.shape, np.int16)
        self._call("cheapest", height, width, depths, volume, _floats(grey), small, large, total, *found)
        return total

    def _reused(self, name: str, shape: tuple[int, ...], dtype: type) -> Array:
        """Return an array in memory that this thread uses again; fresh pages take a tenth of a map's time."""
        kept, count = vars(self._kept), int(np.prod(shape))
        if name not in kept or kept[name].size < count:
            kept[name] = np.empty(count, dtype)
        return np.asarray(kept[name][:count].reshape(shape))

    def fit_planes(
        self,
        inverse_depth: Array,
        tolerance: float,
        *,
        slopes: Array | None = None,
        radius: int = 2,
        stride: int = 1,
        rounds: int = 2,
    ) -> Array:
        """Fit planes as NumPy's `fit_planes`, except for rounding."""
        border = radius * stride
        padded, planes = pad_planes(inverse_depth, slopes, border, LANES)
        self._call(
            "planes",
            *(*inverse_depth.shape, radius, stride, rounds),
            *(ctypes.c_float(tolerance), padded, planes),
        )
        planes[1:] /= np.float32(border)
        return planes

    def compare(
        self, inverse_depth: Array, source_view: SourceView, other: Array, agreement: Agreement
    ) -> tuple[Array, Array]:
        """Compare surfaces as NumPy's `compare`, except for rounding."""
        same, able = (np.empty(inverse_depth.shape, bool) for _ in range(2))
        rays = [np.linalg.inv(one.view.matrix) for one in (source_view.source, source_view.reference)]
        rotation = source_view.rotation.T
        pair = np.concatenate(
            [
                source_view.numbers,
                rotation.reshape(-1),
                -rotation @ source_view.translation,
                *(inverse[row, [row, 2]] for inverse in rays for row in (0, 1)),
                [source_view.reference.view.focal, *agreement],
            ]
        )
        bordered = cv2.copyMakeBorder(_floats(other), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(0.0,))
        self._call(
            "votes",
            *(*inverse_depth.shape, _floats(inverse_depth)),
            *(*other.shape, bordered),
            *(_floats(pair), same, able),
        )
        return same, able

    def fuse(
        self, maps: Sequence[PosedMap], required: int, error: float, cosine: float
    ) -> tuple[Array, Array]:
        """Return places, normals and colours of points (n, 9), and the maps (n, maps) that each is from."""
        given, arrays = (_Map * len(maps))(), []
        for one, (view, depth, normals, picture) in zip(given, maps, strict=True):
            if not (*depth.shape, 3) == normals.shape == picture.shape:
                raise ValueError(f"a depth map of {depth.shape} has normals or a picture of another size")
            matrix, turn = view.matrix, view.rotation
            numbers = (
                *(matrix @ turn, matrix @ view.translation),
                *(np.linalg.inv(matrix).T @ turn, view.centre, turn),
            )
            arrays += [
                _floats(depth),
                _floats(normals),
                np.ascontiguousarray(picture, np.uint8),
                np.zeros(depth.shape, bool),
            ]
            one.depth, one.normals, one.colours, one.taken = (array.ctypes.data for array in arrays[-4:])
            one.height, one.width = depth.shape
            one.matrices = tuple(np.concatenate([part.ravel() for part in numbers]))
        most = sum(depth.size for _, depth, _, _ in maps) // required + 1
        points, seen = np.empty((most, 9), np.float32), np.empty((most, len(maps)), bool)
        found = ctypes.c_int64()
        self._call(
            "fuse",
            *(len(maps), given, required, ctypes.c_float(error), ctypes.c_float(cosine)),
            *(points, seen, ctypes.byref(found)),
        )
        return points[: found.value], seen[: found.value]

    def _call(self, name: str, *args: object) -> None:
        """Call a kernel; arrays are passed by pointer and must be contiguous."""
        given = [ctypes.c_void_p(arg.ctypes.data) if isinstance(arg, np.ndarray) else arg for arg in args]
        if self._library[name](*given):
            raise MemoryError(f"no memory left for the matching ({name})")


def _source(source_view: SourceView) -> _Source:
    """Return the kernel's view of a source; the image stays in memory as long as its view."""
    picture, numbers = source_view.source, (ctypes.c_float * 13)(*source_view.numbers)
    return _Source(picture.bordered.ctypes.data, picture.view.width, picture.view.height, numbers)


def _floats(array: Array) -> Array:
    return np.ascontiguousarray(array, np.float32)


def load_engine(library: Path) -> SweepEngine:
    """Return the compiled engine if its library was built, else NumPy's with a note that says so."""
    try:
        return CompiledEngine(library)
    except (OSError, ValueError):
        return SweepEngine("by NumPy, six times slower: install simulshot again, with a C compiler")


CPU = load_engine(LIBRARY)
