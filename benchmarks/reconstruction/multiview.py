"""Accuracy, time and memory of multi-view depth, beside plain SGBM, in one run.

    python -m benchmarks.reconstruction.multiview        four scenes, 640x480: the package's studio, a plainer
                                                         one, and two rooms with nearly blank walls
    python -m benchmarks.reconstruction.multiview --size 1920x1440 --condition synced
    python -m benchmarks.reconstruction.multiview --row FOLDER      real images: see `camera_rows`

Each method runs in a process of its own, on the same pictures, after the other; the package's five times with
grey levels that differ by a hundred-thousandth (means, and the spread of the first share). Shares are of all
pixels that have a true depth, empty ones counted as wrong, of the rig's middle camera that has one. Simulated
pictures, but for rows.
"""

import multiprocessing
import os
import pickle
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

from benchmarks.reconstruction.camera_rows import read_row
from benchmarks.reconstruction.multiview_scenes import SCENES, Condition, Rendered
from benchmarks.report import new_parser, print_report, print_rows, talk
from reconstruction.common.geometry import Array, View
from reconstruction.depth.rough_scene import find_rough_scene
from reconstruction.depth.view_choice import choose_reference_view, choose_source_views, smallest_group
from reconstruction.method.tally import Measurements
from reconstruction.method.truth import depth_shares, right_depth
from reconstruction.methods.multiview import sweep_matcher
from reconstruction.methods.multiview.fusion import fuse_maps
from reconstruction.methods.multiview.input_images import undistort_image
from reconstruction.methods.multiview.instant_scoring import count_near, true_surfaces
from reconstruction.methods.multiview.sweep_matcher import match_all_views
from reconstruction.methods.stereo.matching import match_rectified
from reconstruction.methods.stereo.stereo_pair import rectify
from reconstruction.scene.moving_pixels import MARGIN_PX, dilate

Result = dict[str, Any]

SEED_SHARE = 1e-5
"""Relative difference of grey levels between seeds."""
PRECISE = 0.005
"""Relative error of a precise depth."""
NEARER = 0.9
"""The nearest depth that SGBM is told, as a fraction of the true one."""
EDGE_PX, EDGE_SHARE = 2, 0.95
"""Pixels beside an edge have a surface nearer than this fraction of their depth within so many pixels."""


def ours(
    views: dict[str, View],
    condition: Condition,
    reference: str,
    *,
    quick: bool = False,
    planes: bool = True,
    seed: int = 0,
) -> Result:
    """Run the package: every view's depth, checked by the others, fused; motion is known from the truth.

    Without `planes`, blank walls stay as they were found.
    """
    images = {name: undistort_image(name, 0, condition.pictures[name], view) for name, view in views.items()}
    begun, cpu = time.perf_counter(), time.process_time()
    calibrated = {
        name: replace(
            image.calibrated,
            grey=image.calibrated.grey * np.float32(1 + seed * SEED_SHARE),
            moving=dilate(condition.movers[name], MARGIN_PX),
        )
        for name, image in images.items()
    }
    scene = find_rough_scene(calibrated)
    sources = choose_source_views(views, scene.points)
    with nullcontext() if planes else patch.object(sweep_matcher, "fit_blank_walls", _as_found):
        found = match_all_views(calibrated, sources, scene.depth_ranges, has_thin=scene.has_thin, quick=quick)
    matched, matched_cpu = time.perf_counter() - begun, time.process_time() - cpu
    colours = {name: image.colours for name, image in images.items()}
    cloud = fuse_maps(views, found, colours, smallest_group(sources)).points
    fused, fused_cpu = time.perf_counter() - begun, time.process_time() - cpu
    result = _shares(found[reference].depth, condition, reference)
    result |= {"map_s": matched / len(found), "map_cpu_s": matched_cpu / len(found), "all_fused_s": fused}
    result |= {"all_fused_cpu_s": fused_cpu}
    result |= {"peak_mb": _peak_mb(), "points": len(cloud), "views_within_2pct": {
        name: depth_shares(view.depth, condition.depth[name], condition.movers[name])["within_2pct"]
        for name, view in found.items()
    }}  # fmt: skip
    return result | _cloud_scores(cloud, views, condition)


def _cloud_scores(points: Array, views: dict[str, View], condition: Condition) -> dict[str, float]:
    """Return precision, recall and F-score of a fused cloud at 1 cm against what two views can see."""
    still = {name: np.zeros_like(moving) for name, moving in condition.movers.items()}
    true, shared = true_surfaces(views, condition.depth, still, ["static"])["static"]
    found = {"precision": count_near(true, points), "recall": count_near(points, shared)}
    scores = Measurements(found)
    return {f"{name}_1cm": scores.value(name) for name in (*found, "f_score")}


def _as_found(_images: Any, _sources: Any, _ranges: Any, surfaces: Any, _pool: Any, planes: Any) -> Any:
    return surfaces, planes


def sgbm(views: dict[str, View], condition: Condition, reference: str) -> Result:
    """Run plain SGBM on every pair with the reference; its map is the best of them, chosen by the truth."""
    begun, cpu = time.perf_counter(), time.process_time()
    maps = _sgbm_maps(views, condition, reference)
    seconds, cpu_seconds = time.perf_counter() - begun, time.process_time() - cpu
    best = max((_shares(depth, condition, reference) for depth in maps), key=lambda one: one["within_2pct"])
    return best | {
        "map_s": seconds / len(maps), "map_cpu_s": cpu_seconds / len(maps), "peak_mb": _peak_mb()
    }  # fmt: skip


def _sgbm_maps(views: dict[str, View], condition: Condition, reference: str) -> list[Array]:
    """Run OpenCV's SGBM on the reference with each other camera, told the nearest depth.

    Images are padded by the number of disparities, because SGBM leaves out as many columns.
    """
    grey = {name: cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for name, image in condition.pictures.items()}
    truth = condition.depth[reference]
    nearest_m = NEARER * float(truth[truth > 0].min())
    view = views[reference]
    found = []
    for other in views.keys() - {reference}:
        baseline = float(np.linalg.norm(view.centre - views[other].centre))
        count = int(np.ceil(view.focal * baseline / nearest_m / 16)) * 16
        canvas = rectify(view, views[other], (0.0, float(count)))
        a, b = canvas.remap(grey[reference])[0], canvas.remap(grey[other], other=True)[0]
        found.append(canvas.depth(match_rectified(a, b, 0, count)))
    return found


METHODS: dict[str, Callable[..., Result]] = {
    "multiview": ours,
    "multiview --quick": partial(ours, quick=True),
    "multiview without planes": partial(ours, planes=False),
    "SGBM, best pair": sgbm,
}


def _shares(depth: Array, condition: Condition, reference: str) -> Result:
    shares = depth_shares(depth, condition.depth[reference], condition.movers[reference])
    truth = condition.depth[reference]
    given = (depth > 0) & (truth > 0)
    right, precise = right_depth(depth, truth), right_depth(depth, truth, PRECISE)
    wrong = float(np.mean(~right[given])) if given.any() else None
    nearest = cv2.erode(np.where(truth > 0, truth, np.inf), np.ones((2 * EDGE_PX + 1,) * 2, np.uint8))
    beside = (truth > 0) & (nearest < EDGE_SHARE * truth)
    return {
        **shares,
        "precise": float(np.mean(precise[truth > 0])),
        "coverage": float(np.mean(depth > 0)),
        "edges_within_2pct": float(np.mean((right & given)[beside])),
        "given_wrong": wrong,
    }


def _true_points(view: View, depth: Array) -> Array:
    """Return sampled points (n, 3) of a true depth map, in the rig's frame."""
    rows, columns = (axis[::16, ::16].ravel() for axis in np.mgrid[0 : view.height, 0 : view.width])
    z = depth[rows, columns].astype(float)
    points: Array = view.unproject(np.column_stack([columns, rows]).astype(float), z)[z > 0]
    return points


def _peak_mb() -> float:
    """Return this process's peak memory, MB; `getrusage` would include its parent's from before the start."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1000


def _child(method: str, condition: str, path: str, seeds: int) -> Result:
    with Path(path).open("rb") as file:
        rendered: Rendered = pickle.load(file)  # noqa: S301
    true = {name: _true_points(view, rendered.synced.depth[name]) for name, view in rendered.views.items()}
    reference = choose_reference_view(rendered.views, true)
    found = []
    # Only the package's planes on blank walls are sensitive to tiny changes.
    for seed in range(seeds if method.startswith("multiview") else 1):
        given = {"seed": seed} if seed else {}
        found.append(METHODS[method](rendered.views, getattr(rendered, condition), reference, **given))
    shares = [one["within_2pct"] for one in found]
    mean = {
        key: float(np.mean([one[key] for one in found]))
        for key, value in found[0].items()
        if isinstance(value, float | int)
    }
    # From the second seed on, the peak includes the scoring of the previous cloud.
    first = {"peak_mb": found[0]["peak_mb"], "spread": max(shares) - min(shares), "seeds": len(found)}
    return {**found[0], **mean, **first}


def run(rendered: Rendered, methods: Sequence[str], conditions: Sequence[str], seeds: int) -> list[Result]:
    """Run every method on the conditions, one after the other, each in a new process."""
    spawn = multiprocessing.get_context("spawn")
    # As in the commands.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.pickle"
        path.write_bytes(pickle.dumps(rendered))
        for method in methods:
            for condition in conditions:
                pool = spawn.Pool(1)
                found = pool.apply(_child, (method, condition, str(path), seeds))
                pool.close()
                pool.join()
                rows.append({"scene": rendered.name, "method": method, "condition": condition, **found})
                talk(f"{rendered.name}, {method}, {condition}: {found['within_2pct']:.1%} within 2 %")
    return rows


COLUMNS = {
    "scene": ("scene", ""),
    "method": ("method", ""),
    "condition": ("condition", ""),
    "within_2pct": ("within 2 %", ".1%"),
    "precise": (f"{100 * PRECISE:g} %", ".1%"),
    "spread": ("spread", ".1%"),
    "mover_within_2pct": ("movers", ".1%"),
    "static_within_2pct": ("static", ".1%"),
    "edges_within_2pct": ("edges", ".1%"),
    "mover_coverage": ("movers covered", ".1%"),
    "coverage": ("covered", ".1%"),
    "given_wrong": ("of that wrong", ".1%"),
    "median_error_pct": ("median, %", ".2f"),
    "map_s": ("s/map", ".2f"),
    "map_cpu_s": ("cpu", ".2f"),
    "peak_mb": ("MB", ".0f"),
    "all_fused_s": ("fused s", ".1f"),
    "all_fused_cpu_s": ("cpu", ".1f"),
    "f_score_1cm": ("F 1 cm", ".2f"),
}


def main() -> None:
    """Print a table, or JSON."""
    parser = new_parser(__doc__)
    parser.add_argument("--scene", action="append", choices=list(SCENES), help="[default: all]")
    parser.add_argument("--row", action="append", type=Path, help="a real row of cameras, instead of scenes")
    parser.add_argument("--size", default="640x480", help="of the pictures")
    parser.add_argument("--method", action="append", choices=list(METHODS), help="[default: all]")
    parser.add_argument("--condition", action="append", choices=["synced", "offset"], help="[default: both]")
    parser.add_argument(
        "--seeds", type=int, default=5, help="grey levels that differ by next to nothing [default: 5]"
    )
    chosen = parser.parse_args()
    width, height = (int(part) for part in chosen.size.split("x"))
    shown = [read_row(folder) for folder in chosen.row or ()]
    names = chosen.scene or ([] if shown else list(SCENES))
    conditions = chosen.condition or (("synced",) if chosen.row else ("synced", "offset"))
    rows: list[Result] = []
    for rendered in (*shown, *(SCENES[name](width, height) for name in names)):
        rows += run(rendered, chosen.method or list(METHODS), conditions, chosen.seeds)
    print_report({"rows": rows}, lambda report: print_rows(report["rows"], COLUMNS), as_json=chosen.json)


if __name__ == "__main__":
    main()
