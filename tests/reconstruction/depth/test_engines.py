"""The compiled engine, and the GPU's kernels compiled for the CPU, beside the array version."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from capture_app.common.errors import NotAvailableError
from reconstruction.common.geometry import Array
from reconstruction.depth import gpu
from reconstruction.depth.calibrated_image import OUTSIDE, SourceView
from reconstruction.depth.compiled import CPU, CompiledEngine, load_engine
from reconstruction.depth.compiling import compile_kernels
from reconstruction.depth.cost_volume import BETTER_OF_TWO, cost_volume
from reconstruction.depth.gpu import GpuEngine, GpuVolume, find_engine, use_gpu
from reconstruction.depth.plane_sweep import SweepOptions, sweep_view
from reconstruction.depth.rough_scene import find_rough_scene
from reconstruction.depth.sweep_engine import (
    Agreement,
    SweepEngine,
    aggregate_costs,
    cheapest_depths,
)
from reconstruction.depth.sweep_matcher import match_all_views
from tests.reconstruction.depth.cuda_stand_in import COMPILER, StandIn
from tests.reconstruction.depth.small_views import PLACES, choose_by_depth, photo_of, view_at

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no g++ here to compile the kernels for the CPU")
GPU = GpuEngine(StandIn())
NUMPY = SweepEngine()
OFFSETS = np.linspace(0.3, 0.7, 21)


def source_views(count: int, window: int) -> list[SourceView]:
    places = [(-0.15, 0.0), (0.15, 0.03), (0.0, 0.2), (-0.1, -0.15)][:count]
    reference = replace(photo_of(view_at(0.0))[0], window=window)
    return [SourceView(reference, photo_of(view_at(*at), seed=i + 1)[0]) for i, at in enumerate(places)]


def array_version(views: list[SourceView], base: Array | None, offsets: Array) -> Array:
    """The costs by plain NumPy in float32, step by step in the kernel's order."""
    one = np.float32(1)
    reference, radius = views[0].reference, views[0].reference.window // 2
    height, width = reference.grey.shape
    ys, xs = np.pad(np.mgrid[0:height, 0:width], ((0, 0), (radius, radius), (radius, radius)), "reflect")
    shown = reference.grey[ys, xs]
    near = np.zeros(ys.shape, np.float32) if base is None else base[ys, xs]
    xs, ys = xs.astype(np.float32), ys.astype(np.float32)
    outside = np.float32(OUTSIDE)

    def window_sum(values: Array) -> Array:
        total = np.zeros((height, width), np.float32)
        for dy in range(2 * radius + 1):
            for dx in range(2 * radius + 1):
                total += values[dy : dy + height, dx : dx + width]
        return total * (one / np.float32((2 * radius + 1) ** 2))

    costs = np.empty((height, len(offsets), width), np.uint8)
    for number, offset in enumerate(offsets.astype(np.float32)):
        found = []
        for view in views:
            m, shift = view.plane_warp(0.0).astype(np.float32), view.shift.astype(np.float32)
            w = near + offset
            u, v, z = (m[i, 0] * xs + m[i, 1] * ys + m[i, 2] + shift[i] * w for i in range(3))
            z = np.maximum(z, np.float32(1e-6))
            warped = bilinear(view.source.grey, u / z, v / z, outside)
            both = window_sum(warped * shown)
            mean = window_sum(warped)
            spread = np.maximum(window_sum(warped * warped) - mean * mean, 0) + np.float32(view.source.noise)
            both = (both - mean * reference.mean) / (np.sqrt(spread) * reference.deviation)
            both[mean < 0] = 0
            found.append(np.maximum(both, 0))
        total, least = np.zeros_like(found[0]), np.min(found, axis=0)
        for likeness in found:
            total += likeness
        if len(found) == 2:
            better = np.float32(BETTER_OF_TWO)
            total = total * better + least * (one - np.float32(2) * better)
        elif len(found) > 2:
            total = (total - least) * (one / np.float32(len(found) - 1))
        costs[:, number] = (np.float32(255) - np.float32(255) * np.minimum(total, one)).astype(np.uint8)
    return costs


def bilinear(picture: Array, u: Array, v: Array, outside: np.float32) -> Array:
    height, width = picture.shape
    bordered = np.pad(picture, 1, constant_values=outside)
    there = (u > -1) & (v > -1) & (u < width) & (v < height)
    u, v = np.where(there, u, 0), np.where(there, v, 0)
    x, y = np.floor(u).astype(int), np.floor(v).astype(int)
    right, down = u - x.astype(np.float32), v - y.astype(np.float32)
    tl, tr, bl, br = (bordered[y + 1 + dy, x + 1 + dx] for dy in (0, 1) for dx in (0, 1))
    above, below = tl + (tr - tl) * right, bl + (br - bl) * right
    return np.where(there, above + (below - above) * down, outside)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> CompiledEngine:
    """The compiled engine of this checkout's own text, whatever was installed."""
    library = tmp_path_factory.mktemp("kernels") / "kernels.so"
    assert compile_kernels(library)
    return CompiledEngine(library)


@pytest.fixture(params=["gpu", "compiled"])
def engine(request: pytest.FixtureRequest, compiled: CompiledEngine) -> SweepEngine:
    return GPU if request.param == "gpu" else compiled


def on_host(volume: GpuVolume | Array) -> Array:
    """Height x depths x width, as on the CPU."""
    if isinstance(volume, GpuVolume):
        return np.asarray(volume.costs)[..., : volume.count].transpose(0, 2, 1)
    return volume


@pytest.mark.parametrize(
    ("count", "window", "curved"),
    [(1, 5, False), (2, 7, True), (4, 5, False), (3, 7, True)],
)
def test_costs_are_those_of_the_array_version(
    count: int, window: int, curved: bool, engine: SweepEngine
) -> None:
    views = source_views(count, window)
    ys, xs = np.mgrid[0 : views[0].reference.grey.shape[0], 0 : views[0].reference.grey.shape[1]]
    base = (0.1 * np.sin(xs / 17) + 0.001 * ys).astype(np.float32) if curved else None
    found = on_host(engine.cost_volume(views, base, OFFSETS))
    exact = array_version(views, base, OFFSETS)
    if engine is GPU:
        assert np.array_equal(found, exact)
    # Sums of windows that slide are rounded otherwise.
    assert np.abs(found.astype(int) - exact).max() <= 1
    assert np.mean(found != exact) < 0.02
    assert exact.std() > 20
    # OpenCV rounds otherwise, by a grey level's fraction.
    quick = cost_volume(views, base, OFFSETS)
    off = np.abs(quick.astype(int) - exact)
    assert off.mean() < 0.6
    assert np.mean(off > 8) < 0.002


@pytest.mark.parametrize("shape", [(37, 13, 53), (53, 40, 37), (5, 3, 60), (24, 150, 20), (9, 9, 1)])
def test_scan_is_that_of_the_array_version(shape: tuple[int, int, int], engine: SweepEngine) -> None:
    height, depths, width = shape
    rng = np.random.default_rng(sum(shape))
    costs = rng.integers(0, 256, shape).astype(np.uint8)
    grey = (rng.random((height, width)) * 255).astype(np.float32)
    volume: GpuVolume | Array = costs
    if engine is GPU:
        padded = np.full((height, width, -(-depths // 4) * 4), 255, np.uint8)
        padded[..., :depths] = costs.transpose(0, 2, 1)
        volume = GpuVolume(StandIn().asarray(padded), depths)
    place, own = engine.find_cheapest(volume, grey, 20, 800)
    expected = cheapest_depths(aggregate_costs(costs, grey, 20, 800), costs)
    assert np.array_equal(place, expected[0])
    assert np.array_equal(own, expected[1])


@pytest.mark.parametrize("depths", [1, 2, 13])
def test_sums_of_the_scan_are_those_of_the_array_version(depths: int, engine: SweepEngine) -> None:
    rng = np.random.default_rng(depths)
    costs = rng.integers(0, 256, (41, depths, 35)).astype(np.uint8)
    grey = (rng.random((41, 35)) * 255).astype(np.float32)
    assert np.array_equal(engine.aggregate(costs, grey, 60, 60), aggregate_costs(costs, grey, 60, 60))


@pytest.mark.slow
def test_the_whole_sweep_finds_the_same_on_either_way(engine: SweepEngine) -> None:
    images = {name: photo_of(view_at(*at), seed=i)[0] for i, (name, at) in enumerate(PLACES.items())}
    sources = choose_by_depth({name: image.view for name, image in images.items()})
    depth_ranges = find_rough_scene(images).depth_ranges
    numpy = match_all_views(images, sources, depth_ranges, engine=NUMPY)
    found = match_all_views(images, sources, depth_ranges, engine=engine)
    for name in images:
        one, other = numpy[name].depth, found[name].depth
        assert np.mean((one > 0) == (other > 0)) > 0.99
        both = (one > 0) & (other > 0)
        assert np.median(np.abs(one - other)[both] / one[both]) < 0.001
        assert np.mean(np.abs(one - other)[both] < 0.01 * one[both]) > 0.98


def test_a_picture_that_is_swept_at_a_smaller_size_first_gets_the_same_depth_on_either_way(
    engine: SweepEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    views = source_views(3, 5)
    reference, sources = views[0].reference, [view.source for view in views]
    cells = 24 * reference.grey.size // 3
    by_numpy = sweep_view(reference, sources, (1.0, 4.0), SweepOptions(max_cells=cells, engine=NUMPY))
    # What NumPy makes of arrays often lies column by column; kernels read row by row.
    reference, *sources = (replace(one, grey=np.asfortranarray(one.grey)) for one in (reference, *sources))
    fit_planes = engine.fit_planes
    monkeypatch.setattr(engine, "fit_planes", lambda *a, **k: np.asfortranarray(fit_planes(*a, **k)))
    found = sweep_view(reference, sources, (1.0, 4.0), SweepOptions(max_cells=cells, engine=engine))
    off = np.abs(by_numpy.inverse_depth / found.inverse_depth - 1)
    assert np.median(off) < 0.001
    assert np.mean(off > 0.01) < 0.02


def test_kernels_read_row_by_row_what_lies_column_by_column(engine: SweepEngine) -> None:
    views = source_views(2, 5)
    base = np.asfortranarray(np.linspace(0, 0.2, views[0].reference.grey.size, dtype=np.float32))
    base = base.reshape(views[0].reference.grey.shape, order="F")
    assert not base.flags.c_contiguous
    found = on_host(engine.cost_volume(views, base, OFFSETS))
    assert np.abs(found.astype(int) - array_version(views, base, OFFSETS)).max() <= (engine is not GPU)


@pytest.mark.parametrize(("radius", "stride", "rounds"), [(2, 2, 3), (3, 3, 2), (1, 1, 2)])
def test_planes_are_those_of_the_array_version(
    radius: int, stride: int, rounds: int, compiled: CompiledEngine
) -> None:
    rng = np.random.default_rng(radius)
    ys, xs = np.mgrid[0:43, 0:61]
    level = np.where(xs > 30, 0.5 + 0.001 * xs, 0.3 - 0.002 * ys) + 0.003 * rng.standard_normal(xs.shape)
    slopes = 0.001 * rng.standard_normal((2, *xs.shape)).astype(np.float32)
    for start in (None, slopes):
        options: Any = {"slopes": start, "radius": radius, "stride": stride, "rounds": rounds}
        found = compiled.fit_planes(level.astype(np.float32), 0.01, **options)
        assert np.abs(found - NUMPY.fit_planes(level.astype(np.float32), 0.01, **options)).max() < 1e-5


def test_votes_are_those_of_the_array_version(compiled: CompiledEngine) -> None:
    view = source_views(1, 5)[0]
    rng = np.random.default_rng(3)
    ys, xs = np.mgrid[0 : view.reference.grey.shape[0], 0 : view.reference.grey.shape[1]]
    mine = (0.5 + 0.05 * np.sin(xs / 9) + 0.003 * rng.standard_normal(xs.shape)).astype(np.float32)
    other = (0.5 + 0.05 * np.sin(xs / 9 + ys / 30)).astype(np.float32)
    agreement = Agreement(0.02, 0.01, 1.0, float(np.cos(np.radians(45))))
    pairs = (engine.compare(mine, view, other, agreement) for engine in (compiled, NUMPY))
    for found, expected in zip(*pairs, strict=True):
        assert np.mean(found != expected) < 0.002
        assert 0.05 < expected.mean() < 0.99


def test_what_is_seen_through_a_surface_is_that_of_the_array_version(compiled: CompiledEngine) -> None:
    view = source_views(1, 5)[0]
    ys, xs = np.mgrid[0 : view.reference.grey.shape[0], 0 : view.reference.grey.shape[1]]
    level = (0.5 + 0.2 * np.sin(xs / 9) + 0.001 * ys).astype(np.float32)
    found, expected = (engine.warp(view, level) for engine in (compiled, NUMPY))
    assert 0.02 < np.mean(expected < 0) < 0.5
    assert np.mean((found < 0) != (expected < 0)) < 0.01
    inside = (found >= 0) & (expected >= 0)
    # OpenCV rounds places to a 32nd of a pixel.
    assert np.abs(found - expected)[inside].mean() < 0.5


def test_without_a_library_numpy_sweeps_and_the_note_says_so(tmp_path: Path) -> None:
    found = load_engine(tmp_path / "kernels.so")
    assert type(found) is SweepEngine
    assert found.note == "by NumPy, three times slower: no C compiler was there when simulshot was installed"


class Cuda:
    """`cupy.cuda` of a machine with so many GPUs."""

    def __init__(self, count: int) -> None:
        self.runtime = SimpleNamespace(
            getDeviceCount=lambda: count, getDeviceProperties=lambda number: {"name": b"Some GPU"}
        )


class Machine(StandIn):
    """CuPy on it; a module that does not compile as with a driver that is too old."""

    def __init__(self, count: int, *, fault: str = "") -> None:
        self.cuda = Cuda(count)
        if fault:
            self.RawModule = self.refuse  # type: ignore[assignment]
        self.fault = fault

    def refuse(self, *, code: str, options: tuple[str, ...]) -> None:
        raise RuntimeError(self.fault)


def test_a_gpu_is_used_where_it_does_what_it_should() -> None:
    found = use_gpu(Machine(1))
    assert isinstance(found, GpuEngine)
    assert found.note == "on Some GPU"


@pytest.mark.parametrize(
    ("machine", "note"),
    [
        (Machine(0), "on the CPU: CuPy finds no GPU"),
        (Machine(1, fault="no nvrtc\nat line 3"), "on the CPU: the GPU cannot be used (no nvrtc)"),
    ],
)
def test_without_a_usable_gpu_the_cpu_sweeps_and_the_note_says_why(machine: Machine, note: str) -> None:
    found = use_gpu(machine)
    assert (type(found), found.note) == (type(CPU), note + (CPU.note and f"; {CPU.note}"))


def test_a_gpu_that_fails_later_ends_the_run_with_a_sentence() -> None:
    machine = Machine(1)
    engine = use_gpu(machine)
    machine.zeros = fail_for_memory  # type: ignore[assignment]
    volume = GpuVolume(StandIn().asarray(np.zeros((4, 4, 4), np.uint8)), 4)
    with pytest.raises(NotAvailableError, match=r"the GPU failed: Out of memory \(CUDA_VISIBLE_DEVICES="):
        engine.find_cheapest(volume, np.zeros((4, 4), np.float32), 1, 2)


@pytest.fixture
def looked_for() -> Iterator[None]:
    """Engines are looked for in the test, and again after it."""
    find_engine.cache_clear()
    yield
    find_engine.cache_clear()


@pytest.mark.usefixtures("looked_for")
def test_a_broken_cupy_leaves_the_cpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cupy.py").write_text("raise ValueError('numpy.dtype size changed')")
    monkeypatch.syspath_prepend(tmp_path)
    found = find_engine()
    assert type(found) is type(CPU)
    assert found.note.startswith("on the CPU: CuPy is broken (numpy.dtype size changed)")


@pytest.mark.usefixtures("looked_for")
@pytest.mark.parametrize("compiled", [True, False])
def test_the_terminal_says_once_that_numpy_sweeps(
    compiled: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "cupy", None)
    engine = SweepEngine("" if compiled else "by NumPy, three times slower")
    monkeypatch.setattr(gpu, "CPU", engine)
    assert find_engine() is find_engine() is engine
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == ("" if compiled else "depth by NumPy, three times slower\n")


def fail_for_memory(*_: object) -> None:
    raise RuntimeError("Out of memory")
