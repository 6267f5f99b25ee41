"""Sweep engine for GPUs of any vendor: wgpu-py runs the WebGPU kernels of `kernels.wgsl`."""

import importlib
import os
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import cv2
import numpy as np

from capture_app.common.errors import NotAvailableError
from capture_app.console.terminal import talk
from reconstruction.common.geometry import Array, View
from reconstruction.depth.calibrated_image import OUTSIDE, CalibratedImage, SourceView
from reconstruction.depth.sweep_engine import BETTER_OF_TWO, CPU, JUMP_GREY, MIN_JUMP, SweepEngine

GPU = "SIMULSHOT_GPU"
"""Environment variable: part of the name of the GPU to use; empty for none."""
KERNELS = Path(__file__).with_name("kernels.wgsl")
DEVICES = "dri/renderD*", "nvidia[0-9]*", "dxg", "mali*", "kgsl*"
"""Device files in /dev of the GPUs that Linux's drivers offer."""
HARDWARE = ("DiscreteGPU", "IntegratedGPU", "VirtualGPU")
"""Kinds of adapters that are used without being named, best first."""
MAX_BAND_BYTES = 1 << 26
"""Maximum size of a band's totals: a driver resets a GPU that is busy with one command for seconds."""
ALIGNED = 256
"""Offsets of bindings are multiples of this many bytes; a dispatch's parameters fit."""
TASK, PICTURES, TABLE, COSTS, TOTAL, CARRIED, FOUND = range(7)
"""The kernels' bindings; the first three are only read."""
COPIED_STORAGE, IN_KERNELS = 0x4 | 0x8 | 0x80, 0x4
"""WebGPU's flags: buffers are copied from and to and bound as storage; kernels see bindings."""
COSTS_OFF, PLACE_OFF, MIN_RIGHT = 1, 0.05, 0.99
"""To pass the test: maximum difference of costs and places from the CPU's, at this fraction of pixels."""
T = TypeVar("T")
GpuVolume = tuple[Sequence[SourceView], Array | None, Array]
"""The arguments of `cost_volume`: costs are computed when they are used, and stay on the GPU."""


class GpuEngine(SweepEngine):
    """Engine of the sweep on an adapter of wgpu-py; after a failure of the GPU it goes on with the CPU."""

    def __init__(self, adapter: Any, max_band_bytes: int = MAX_BAND_BYTES) -> None:
        super().__init__(f"on {adapter.info['device']}")
        limits = {key: adapter.limits[key] for key in ("max-buffer-size", "max-storage-buffer-binding-size")}
        self.device = adapter.request_device_sync(required_limits=limits)
        self._band_bytes = min(max_band_bytes, *limits.values())
        self._layout = self.device.create_bind_group_layout(entries=list(map(_binding, range(7))))
        self._buffers: dict[int, Any] = {}
        self._uploads: WeakKeyDictionary[CalibratedImage, dict[object, Any]] = WeakKeyDictionary()
        self._lock = threading.Lock()
        self._compiled = cache(self._compile)

    def cost_volume(
        self, source_views: Sequence[SourceView], base: Array | None, offsets: Array
    ) -> GpuVolume:
        """Return the arguments; `find_cheapest` computes the costs as on the CPU, except for rounding."""
        return source_views, base, offsets

    def find_cheapest(self, volume: GpuVolume, grey: Array, small: int, large: int) -> tuple[Array, Array]:
        """Find the cheapest depths as on the CPU; `grey` is that of the volume's reference."""
        cheapest = self._try(lambda: self.cheapest(volume, small, large))
        return (
            CPU.find_cheapest(CPU.cost_volume(*volume), grey, small, large) if cheapest is None else cheapest
        )

    def costs_along(self, source_views: Sequence[SourceView], inverse_depth: Array) -> Array:
        """Compute costs along a surface as on the CPU, except for rounding."""
        costs = self._try(lambda: self.costs((source_views, inverse_depth, np.zeros(1))))
        return CPU.costs_along(source_views, inverse_depth) if costs is None else costs[:, 0]

    def _try(self, compute: Callable[[], T]) -> T | None:
        """Return what the GPU computes, or None from its first failure on (lost, no memory)."""
        with self._lock:
            try:
                return None if self.device is None else compute()
            # wgpu's errors have no common base.
            except Exception as error:  # noqa: BLE001
                talk(f"the GPU failed ({_cause(error)}): depth goes on with the CPU")
                self.note += ", and on the CPU from its failure on"
                self.device = None
                self._buffers.clear()
                self._uploads.clear()
                return None

    def costs(self, volume: GpuVolume) -> Array:
        """Return the costs (height x depths x width, uint8); errors are wgpu's."""
        costs = self._run(volume, 0, 0, scan=False).reshape(*volume[0][0].reference.grey.shape, -1)
        return np.ascontiguousarray(costs[..., : len(volume[2])].transpose(0, 2, 1))

    def cheapest(self, volume: GpuVolume, small: int, large: int) -> tuple[Array, Array]:
        """Return place and cost of the cheapest depths; errors are wgpu's."""
        cheapest = self._run(volume, small, large).view(np.float32)
        place, own = cheapest.reshape(2, *volume[0][0].reference.grey.shape)
        return place, own

    def _run(self, volume: GpuVolume, small: int, large: int, *, scan: bool = True) -> Array:
        """Return the bytes of the cheapest depths' places and costs; without a scan those of all costs."""
        source_views, base, offsets = volume
        reference = source_views[0].reference
        height, width = reference.grey.shape
        words = -(-len(offsets) // 4)
        lanes = 1 << (words - 1).bit_length()
        rows = min(max(1, self._band_bytes // (8 * words * width)), height)
        used = 4 * words * width * rows
        band = -(-used // ALIGNED) * ALIGNED
        tops = range(0, height, rows)
        begin = 4 * height * width
        pictures = self._buffer(
            PICTURES, 4 * (begin + sum(source_view.source.grey.size for source_view in source_views))
        )
        surface = np.zeros((height, width)) if base is None else base
        self.device.queue.write_buffer(pictures, 3 * begin, np.ascontiguousarray(surface, np.float32))
        encoder = self.device.create_command_encoder()
        shown = self._upload(reference, "grey", "mean", "deviation")
        encoder.copy_buffer_to_buffer(shown, 0, pictures, 0, shown.size)
        table = [_bits(offsets)]
        for one in source_views:
            grey = self._upload(one.source, "grey")
            encoder.copy_buffer_to_buffer(grey, 0, pictures, 4 * begin, grey.size)
            table += np.array([begin, *one.source.grey.shape[::-1]], np.int32), _bits(one.numbers)
            begin += one.source.grey.size
        # wgpu takes what is bound at offsets for unwritten, and would clear new costs before they are read.
        for part, size in ((COSTS, band), (TOTAL, 2 * band)):
            encoder.clear_buffer(self._buffer(part, size * len(tops)))
        steps = [("match_windows", i, 0, (-(-width // 16), -(-rows // 8), words)) for i in range(len(tops))]
        if scan:
            paths = -(-(width + rows) * lanes // 128)
            for i in range(len(tops)):
                steps += ("scan", i, 0, (paths, 5, 1)), ("scan", len(tops) - 1 - i, 5, (paths, 3, 1))
            steps += (("choose", i, 0, (-(-width // 64), rows, 1)) for i in range(len(tops)))
        same = height, width, len(offsets), words, len(source_views), small, large
        tasks = np.zeros((len(steps), ALIGNED // 4), np.int32)
        tasks[:, :11] = [(tops[i], min(rows, height - tops[i]), i % 2, way, *same) for _, i, way, _ in steps]
        bound = [
            (self._write(TASK, tasks), ALIGNED),
            (pictures, 4 * begin),
            (self._write(TABLE, np.concatenate(table)), 4 * (len(offsets) + 16 * len(source_views))),
            (self._buffers[COSTS], band),
            (self._buffers[TOTAL], 2 * band),
            (self._buffer(CARRIED, ALIGNED * width * words), ALIGNED * width * words),
            (self._buffer(FOUND, 8 * height * width), 8 * height * width),
        ]
        entries = [
            {"binding": i, "resource": {"buffer": buffer, "offset": 0, "size": size}}
            for i, (buffer, size) in enumerate(bound)
        ]
        group = self.device.create_bind_group(layout=self._layout, entries=entries)
        run = encoder.begin_compute_pass()
        for number, (name, i, _, groups) in enumerate(steps):
            run.set_pipeline(self._compiled(name, reference.window // 2, lanes))
            run.set_bind_group(0, group, [number * ALIGNED, i * band, 2 * i * band])
            run.dispatch_workgroups(*groups)
        run.end()
        self.device.queue.submit([encoder.finish()])
        read, size = (FOUND, 8 * height * width) if scan else (COSTS, band * len(tops))
        values = np.frombuffer(self.device.queue.read_buffer(self._buffers[read], 0, size), np.uint8)
        if scan:
            return values
        return values.reshape(len(tops), -1)[:, :used].reshape(-1)[: 4 * words * width * height]

    def _buffer(self, binding: int, size: int) -> Any:
        """Return the buffer of a binding, kept between calls and replaced by a larger one when needed."""
        if binding not in self._buffers or self._buffers[binding].size < size:
            self._buffers[binding] = self.device.create_buffer(size=size, usage=COPIED_STORAGE)
        return self._buffers[binding]

    def _write(self, binding: int, array: Array) -> Any:
        self.device.queue.write_buffer(self._buffer(binding, array.nbytes), 0, array)
        return self._buffers[binding]

    def _upload(self, image: CalibratedImage, *parts: str) -> Any:
        """Return arrays of an image one after the other on the GPU, uploaded once in the image's lifetime."""
        held = self._uploads.setdefault(image, {})
        if parts not in held:
            data = np.stack([getattr(image, part) for part in parts]).astype(np.float32)
            held[parts] = self.device.create_buffer_with_data(data=data, usage=COPIED_STORAGE)
        return held[parts]

    def _compile(self, name: str, half_window: int, lanes: int) -> Any:
        constants = {"R": half_window, "LANES": lanes, "OUTSIDE": OUTSIDE, "BETTER": BETTER_OF_TWO}
        constants |= {"JUMP_GREY": float(JUMP_GREY), "MIN_JUMP": MIN_JUMP}
        text = "".join(f"const {key} = {value};\n" for key, value in constants.items()) + KERNELS.read_text()
        kernel = {"module": self.device.create_shader_module(code=text), "entry_point": name}
        layout = self.device.create_pipeline_layout(bind_group_layouts=[self._layout])
        return self.device.create_compute_pipeline(layout=layout, compute=kernel)


def _bits(floats: Array) -> Array:
    return floats.astype(np.float32).view(np.int32)


def _binding(number: int) -> dict[str, Any]:
    """Return the layout of a binding: what changes from dispatch to dispatch is bound at an offset."""
    buffer = {
        "type": "read-only-storage" if number < COSTS else "storage",
        "has_dynamic_offset": number in (TASK, COSTS, TOTAL),
    }
    return {"binding": number, "visibility": IN_KERNELS, "buffer": buffer}


def _cause(error: Exception) -> str:
    """Return the last line of an error: wgpu's begin with the chain of calls."""
    return (str(error).strip() or type(error).__name__).splitlines()[-1].strip()


def has_gpu(devices: Path = Path("/dev")) -> bool:
    """Return whether this machine may have a GPU; loading wgpu-py to ask takes half a second."""
    return sys.platform != "linux" or any(any(devices.glob(name)) for name in DEVICES)


def find_adapters() -> Sequence[Any]:
    """Return the adapters of wgpu-py; raises ImportError where it is not installed."""
    extras = importlib.import_module("wgpu.backends.wgpu_native.extras")
    # Mesa's choice of a default complains on machines without a screen; OpenGL lacks what the kernels need.
    os.environ.setdefault("NODEVICE_SELECT", "1")
    with suppress(RuntimeError):  # only before the first use of wgpu-py in a process
        extras.set_instance_extras(backends=("Primary",))
    return list(importlib.import_module("wgpu").gpu.enumerate_adapters_sync())


def open_gpu(adapters: Sequence[Any], named: str = "") -> GpuEngine:
    """Return the engine of the best of wgpu's adapters: hardware, or any `named` by a part of its name.

    Raises NotAvailableError if there is none or it computes wrongly; other errors are wgpu's.
    """
    kinds = (*HARDWARE, "CPU") if named else HARDWARE
    fitting = [adapter for adapter in adapters if adapter.info["adapter_type"] in kinds]
    fitting = [view for view in fitting if named.lower() in view.info["device"].lower()]
    if not fitting:
        raise NotAvailableError(f"no GPU named {named}" if named else "no GPU with Vulkan, Metal or DX12")
    engine = GpuEngine(min(fitting, key=lambda one: kinds.index(one.info["adapter_type"])))
    if not computes_correctly(engine):
        raise NotAvailableError(f"errors in a test {engine.note}")
    return engine


def computes_correctly(engine: GpuEngine) -> bool:
    """Return whether the GPU computes a small sweep (costs, scan, choice) as the CPU does, up to rounding."""
    rng = np.random.default_rng(1)
    views = (
        View(64, 48, np.diag([60.0, 60, 1]), np.zeros(5), np.eye(3), np.array([x, 0.05 * x, 0]))
        for x in (0.0, -0.1, 0.1)
    )
    # Unlike images: the cheapest depths, and the steps between them, are all there are.
    reference, *sources = (
        CalibratedImage(view, cv2.blur(rng.random((48, 64), np.float32) * 255, (3, 3)), 5, 9.0)
        for view in views
    )
    volume = [SourceView(reference, source) for source in sources], None, np.linspace(0, 1, 9)
    costs, cheapest = engine.costs(volume), engine.cheapest(volume, 20, 800)
    exact = CPU.find_cheapest(costs, reference.grey, 20, 800)
    costs_off = np.abs(costs.astype(int) - CPU.cost_volume(*volume))
    same = (np.abs(cheapest[0] - exact[0]) < PLACE_OFF) & (cheapest[1] == exact[1])
    return bool(min(np.mean(costs_off <= COSTS_OFF), np.mean(same)) > MIN_RIGHT)


@cache
def find_engine() -> SweepEngine:
    """Return a GPU's engine if wgpu-py and a GPU are there, else the CPU's; searched and reported once."""
    named, engine = os.environ.get(GPU), CPU
    try:
        if named or (named is None and has_gpu()):
            engine = open_gpu(find_adapters(), named or "")
        elif named is None:
            engine = SweepEngine("on the CPU (this machine has no GPU)")
    # A wgpu without its library, an old driver or a full memory may raise anything.
    except Exception as error:  # noqa: BLE001
        engine = SweepEngine(f"on the CPU ({_cause(error)})")
    if engine.note:
        talk(f"depth {engine.note}")
    return engine


def is_requested() -> bool:
    """Return whether the user names a GPU in the environment."""
    return bool(os.environ.get(GPU))
