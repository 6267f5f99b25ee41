"""The compiled steps of depth beside the same steps by arrays."""

import inspect
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.common.errors import NotAvailableError
from reconstruction.common.geometry import Array
from reconstruction.depth import compiling, plane_sweep, sweep_kernels
from reconstruction.depth.calibrated_image import OUTSIDE, SourceView
from reconstruction.depth.compiling import library_of
from reconstruction.depth.kernels import load_kernels
from reconstruction.depth.plane_sweep import PlaneSweep, Surface
from reconstruction.depth.sweep_kernels import BETTER_OF_TWO, Agreement
from reconstruction.methods.multiview.consistent_pixels import _valid_fraction
from reconstruction.methods.multiview.fusion import PosedMap, find_denied, fuse_posed_maps
from reconstruction.methods.multiview.sweep_matcher import (
    ViewDepth,
    _close_gaps,
    propose_inverse_depth,
)
from tests.unit.reconstruction.depth import array_sweep
from tests.unit.reconstruction.depth.array_sweep import (
    aggregate_costs,
    cheapest_depths,
    splat_arrays,
    sweep_by_arrays,
    valid_fraction,
)
from tests.unit.reconstruction.depth.small_views import (
    HEIGHT,
    WIDTH,
    photo_of,
    view_at,
)
from tests.unit.reconstruction.methods.multiview.array_fusion import denied_by_arrays, fuse_arrays

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
            m, shift = view.at_infinity.astype(np.float32), view.shift.astype(np.float32)
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


def curved_surface(views: list[SourceView]) -> Array:
    ys, xs = np.mgrid[0 : views[0].reference.grey.shape[0], 0 : views[0].reference.grey.shape[1]]
    return (0.1 * np.sin(xs / 17) + 0.001 * ys).astype(np.float32)


@pytest.mark.parametrize(
    ("count", "window", "curved"),
    [(1, 5, False), (2, 7, True), (4, 5, False), (3, 7, True), (3, 9, False)],
)
def test_costs_are_those_of_the_array_version(count: int, window: int, curved: bool) -> None:
    views = source_views(count, window)
    base = curved_surface(views) if curved else None
    found = sweep_kernels.cost_volume(views, base, OFFSETS)
    exact = array_version(views, base, OFFSETS)
    # Sums of windows that slide are rounded otherwise.
    assert np.abs(found.astype(int) - exact).max() <= 1
    assert np.mean(found != exact) < 0.02
    assert exact.std() > 20
    # OpenCV rounds otherwise, by a grey level's fraction.
    quick = array_sweep.cost_volume(views, base, OFFSETS)
    off = np.abs(quick.astype(int) - exact)
    assert off.mean() < 0.6
    assert np.mean(off > 8) < 0.002


@pytest.mark.parametrize("shape", [(37, 13, 53), (53, 40, 37), (5, 3, 60), (24, 150, 20), (9, 9, 1)])
def test_scan_is_that_of_the_array_version(shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(sum(shape))
    costs = rng.integers(0, 256, shape).astype(np.uint8)
    grey = (rng.random((shape[0], shape[2])) * 255).astype(np.float32)
    place, own = sweep_kernels.find_cheapest(costs, grey, 20, 800)
    expected = cheapest_depths(aggregate_costs(costs, grey, 20, 800), costs)
    assert np.array_equal(place, expected[0])
    assert np.array_equal(own, expected[1])


@pytest.mark.parametrize("depths", [1, 2, 13])
def test_sums_of_the_scan_are_those_of_the_array_version(depths: int) -> None:
    rng = np.random.default_rng(depths)
    costs = rng.integers(0, 256, (41, depths, 35)).astype(np.uint8)
    grey = (rng.random((41, 35)) * 255).astype(np.float32)
    assert np.array_equal(
        sweep_kernels.aggregate_costs(costs, grey, 60, 60), aggregate_costs(costs, grey, 60, 60)
    )


def test_a_picture_that_is_swept_at_a_smaller_size_first_gets_the_same_depth_on_either_way(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    views = source_views(3, 5)
    reference, sources = views[0].reference, [view.source for view in views]
    cells = 24 * reference.grey.size // 3
    sweep = PlaneSweep(max_cells=cells)
    with monkeypatch.context() as patch:
        sweep_by_arrays(patch)
        by_numpy = sweep.sweep(reference, sources, (1.0, 4.0))
    # What NumPy makes of arrays often lies column by column; kernels read row by row.
    reference, *sources = (replace(one, grey=np.asfortranarray(one.grey)) for one in (reference, *sources))
    fit_planes = sweep_kernels.fit_planes
    monkeypatch.setattr(plane_sweep, "fit_planes", lambda *a, **k: np.asfortranarray(fit_planes(*a, **k)))
    found = sweep.sweep(reference, sources, (1.0, 4.0))
    off = np.abs(by_numpy.inverse_depth / found.inverse_depth - 1)
    assert np.median(off) < 0.001
    assert np.mean(off > 0.01) < 0.02


def test_kernels_read_row_by_row_what_lies_column_by_column() -> None:
    views = source_views(2, 5)
    base = np.asfortranarray(np.linspace(0, 0.2, views[0].reference.grey.size, dtype=np.float32))
    base = base.reshape(views[0].reference.grey.shape, order="F")
    assert not base.flags.c_contiguous
    exact = array_version(views, base, OFFSETS[:1])[:, 0]
    found = sweep_kernels.costs_along(views, base + np.float32(OFFSETS[0]))
    assert np.abs(found.astype(int) - exact).max() <= 1


@pytest.mark.parametrize(("radius", "stride", "rounds"), [(2, 2, 3), (3, 3, 2), (1, 1, 2)])
def test_planes_are_those_of_the_array_version(radius: int, stride: int, rounds: int) -> None:
    rng = np.random.default_rng(radius)
    ys, xs = np.mgrid[0:43, 0:61]
    level = np.where(xs > 30, 0.5 + 0.001 * xs, 0.3 - 0.002 * ys) + 0.003 * rng.standard_normal(xs.shape)
    slopes = 0.001 * rng.standard_normal((2, *xs.shape)).astype(np.float32)
    for start in (None, slopes):
        options: Any = {"slopes": start, "radius": radius, "stride": stride, "rounds": rounds}
        found = sweep_kernels.fit_planes(level.astype(np.float32), 0.01, **options)
        assert np.abs(found - array_sweep.fit_planes(level.astype(np.float32), 0.01, **options)).max() < 1e-5


def test_votes_are_those_of_the_array_version() -> None:
    view = source_views(1, 5)[0]
    rng = np.random.default_rng(3)
    ys, xs = np.mgrid[0 : view.reference.grey.shape[0], 0 : view.reference.grey.shape[1]]
    mine = (0.5 + 0.05 * np.sin(xs / 9) + 0.003 * rng.standard_normal(xs.shape)).astype(np.float32)
    other = (0.5 + 0.05 * np.sin(xs / 9 + ys / 30)).astype(np.float32)
    agreement = Agreement(0.02, 0.01, 1.0, float(np.cos(np.radians(45))))
    pairs = (steps.compare_surfaces(mine, view, other, agreement) for steps in (sweep_kernels, array_sweep))
    for found, expected in zip(*pairs, strict=True):
        assert np.mean(found != expected) < 0.002
        assert 0.05 < expected.mean() < 0.99


def test_a_scan_in_memory_used_before_is_that_in_fresh_memory() -> None:
    rng = np.random.default_rng(5)
    large, small = (rng.integers(0, 256, (20, depths, 33), np.uint8) for depths in (40, 9))
    grey = rng.uniform(0, 255, (20, 33)).astype(np.float32)
    for costs in (large, small):
        assert np.array_equal(
            sweep_kernels.aggregate_costs(costs, grey, 20, 800), aggregate_costs(costs, grey, 20, 800)
        )


def test_what_is_seen_through_a_surface_is_that_of_the_array_version() -> None:
    view = source_views(1, 5)[0]
    ys, xs = np.mgrid[0 : view.reference.grey.shape[0], 0 : view.reference.grey.shape[1]]
    level = (0.5 + 0.2 * np.sin(xs / 9) + 0.001 * ys).astype(np.float32)
    found, expected = (steps.warp(view, level) for steps in (sweep_kernels, array_sweep))
    assert 0.02 < np.mean(expected < 0) < 0.5
    assert np.mean((found < 0) != (expected < 0)) < 0.01
    inside = (found >= 0) & (expected >= 0)
    # OpenCV rounds places to a 32nd of a pixel.
    assert np.abs(found - expected)[inside].mean() < 0.5


def test_splatted_depth_is_that_of_the_array_version() -> None:
    views = source_views(3, 5)
    maps = []
    for view in views:
        depth = photo_of(view.reference.view)[1].astype(np.float32)
        depth[20:40, 30:60] *= 0.7
        depth[50:60, 50:60] = 0
        maps.append(depth)
    for count in (1, 3):
        expected = np.zeros((HEIGHT, WIDTH), np.float32)
        for view, depth in zip(views[:count], maps, strict=False):
            splat_arrays(view, depth, expected)
        found = propose_inverse_depth(zip(views[:count], maps, strict=False), (HEIGHT, WIDTH))
        assert np.array_equal(found, _close_gaps(expected))
        assert 0.5 < np.mean(found > 0) < 1


def noisy_maps(rng: np.random.Generator) -> list[PosedMap]:
    maps = []
    for k in range(4):
        view = view_at(0.08 * k, 0.03 * (k % 2))
        depth = photo_of(view)[1] * rng.normal(1, 0.006, (view.height, view.width))
        depth[rng.random(depth.shape) < 0.2] = 0
        normals = np.dstack([rng.normal(0, 0.3, (*depth.shape, 2)), -np.ones(depth.shape)])
        picture = rng.integers(0, 255, (*depth.shape, 3)).astype(np.uint8)
        maps.append((view, depth.astype(np.float32), normals.astype(np.float32), picture))
    return maps


@pytest.mark.parametrize("required", [1, 3])
def test_fused_points_are_those_of_the_array_version(required: int) -> None:
    rng = np.random.default_rng(5)
    maps = noisy_maps(rng)
    (found, seen), (expected, shown) = (
        fuse(maps, required, 0.01, 0.9) for fuse in (fuse_posed_maps, fuse_arrays)
    )
    # Places that round to another pixel make a few others.
    assert len(found) == pytest.approx(len(expected), rel=2e-3)
    assert seen.sum(0) == pytest.approx(shown.sum(0), rel=5e-3)
    points, others = ({tuple(row) for row in np.round(one[:, :8], 2).tolist()} for one in (found, expected))
    assert len(points & others) > 0.9 * len(others) > 2000


def test_denied_points_are_those_of_the_array_version() -> None:
    rng = np.random.default_rng(6)
    maps = noisy_maps(rng)
    points, _ = np.split(fuse_posed_maps(maps, 1, 0.01, 0.9)[0][:, :6], 2, axis=1)
    points *= rng.choice([0.97, 1.0, 1.03], (len(points), 1))
    normals = rng.normal(0, 1, points.shape).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    views = {str(k): view for k, (view, *_) in enumerate(maps)}
    # Without small holes: a point beside one is not denied.
    depths = {str(k): cv2.medianBlur(depth, 5) for k, (_, depth, *_) in enumerate(maps)}
    found_depth = {name: ViewDepth(depth, np.zeros((*depth.shape, 3))) for name, depth in depths.items()}
    found, expected = (deny(points, normals, views, found_depth) for deny in (find_denied, denied_by_arrays))
    assert 0.2 < expected.mean() < 0.8
    # Places that round to another pixel.
    assert np.mean(found != expected) < 2e-3


def test_support_is_that_of_the_array_version() -> None:
    rng = np.random.default_rng(7)
    xs = np.mgrid[0:50, 0:70][1]
    level = np.where(xs > 35, 0.5 + 0.001 * xs, 0.4).astype(np.float32) * rng.normal(1, 0.01, xs.shape)
    slopes = np.stack([np.where(xs > 35, 0.001, 0), np.zeros(xs.shape)]).astype(np.float32)
    surface = Surface(level.astype(np.float32), slopes[0], slopes[1], np.zeros(xs.shape, np.float32))
    valid = rng.random(xs.shape) < 0.6
    pixels = np.nonzero(rng.random(xs.shape) < 0.3)
    found, expected = (of(valid, surface, pixels) for of in (_valid_fraction, valid_fraction))
    assert found == pytest.approx(expected, rel=1e-6)
    assert expected.std() > 0.05


def test_kernels_are_compiled_at_first_use_and_again_if_their_source_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, a checkout whose kernels.c was pulled but not compiled gave wrong depth without a word."""
    source = tmp_path / "kernels.c"
    source.write_text("int version(void) { return 1; }")
    load = inspect.unwrap(load_kernels)
    assert load(source).version() == load(source).version() == 1
    source.write_text("int version(void) { return 2; }")
    assert load(source).version() == 2
    source.write_text("int version(void) { return 4; }")
    library_of(source).write_bytes(b"of another machine")
    assert load(source).version() == 4
    assert [one.name for one in tmp_path.glob("*.library")] == [library_of(source).name]
    source.write_text("int version(void) { return 3; }")
    monkeypatch.setattr(compiling, "find_compiler", list)
    with pytest.raises(NotAvailableError, match="not compiled") as refused:
        load(source)
    assert "gcc" in refused.value.hint


def test_pypi_s_compiler_makes_kernels_for_every_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a processor, or with -mtune, it compiles for this machine's; others stop at the first call."""
    monkeypatch.setattr("shutil.which", lambda _name: None)
    monkeypatch.setattr(compiling, "find_spec", lambda _name: object())
    assert compiling.find_compiler()[1:] == ["-m", "ziglang", "cc", "-mcpu=baseline"]
