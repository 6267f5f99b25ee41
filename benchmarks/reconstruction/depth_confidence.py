"""Reliability of depth's confidence: of pixels said to be right with some probability, how many are.

    python -m benchmarks.reconstruction.depth_confidence            four scenes and the sample sessions
    python -m benchmarks.reconstruction.depth_confidence --cameras 2 --cameras 3     the first ones of a scene
    python -m benchmarks.reconstruction.depth_confidence --pose-error 0.5 --draws 8  cameras turned, px
    python -m benchmarks.reconstruction.depth_confidence --row FOLDER       real images: see `camera_rows`
    python -m benchmarks.reconstruction.depth_confidence --fit      the table in `depth.confidence`

Right is within 2 % of the true depth. The table was fitted to two of the scenes; the others and the sessions
judge it. Each row counts the depths of all cameras with a truth; ranges with under 1 % of a row's pixels are
left out. All depths of a rig share the error of its poses, so that only many draws of it can be judged
together: `±` is the standard error of said minus right by the draws, often 10 points with four to eight of
them. The draws of all scenes and pose errors are the same turns, so that rows share their luck. Simulated
pictures, but for rows of cameras.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.reconstruction.camera_rows import read_row
from benchmarks.reconstruction.multiview_scenes import SCENES, Condition, Rendered
from benchmarks.report import new_parser, print_report, print_rows, talk
from reconstruction.common.geometry import Array, View
from reconstruction.depth.rough_scene import find_rough_scene
from reconstruction.depth.view_choice import choose_source_views
from reconstruction.method.truth import right_depth
from reconstruction.methods.multiview.confidence import RIGHT, DepthSupport, measure_support
from reconstruction.methods.multiview.input_images import (
    InputImage,
    InputImages,
    check_images,
    undistort_image,
    undistorted_truth,
)
from reconstruction.methods.multiview.instant_model import measure_confidence
from reconstruction.methods.multiview.sweep_matcher import match_all_views
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import MARGIN_PX, dilate
from reconstruction.scene.scene import Scene

FITTED = "plain", "blank-attic"
SESSIONS = tuple(Path("sample_sessions") / name for name in ("jumper", "pinwheel", "naive"))
INSTANT = 2
RANGES = tuple(k / 10 for k in range(3, 10))
"""Lower ends of ranges of confidence, each 0.1 wide; the first one begins at 0."""
CAMERAS = 5
FITTED_CAMERAS = 2, 3, CAMERAS
MIN_SHARE = 0.01
COLUMNS = {
    "case": ("case", ""),
    "misfit_px": ("misfit, px", ".2f"),
    "said": ("said", ".1%"),
    "right": ("right", ".1%"),
    "draws_error": ("±", ".1%"),
    "worst": ("worst", "+.1%"),
    **{f"at_{k:.1f}": (f"{'up to ' if k == RANGES[0] else ''}{k:.1f} to {k + 0.1:.1f}", "") for k in RANGES},
    "cpu_s": ("CPU-s/map", ".3f"),
}


@dataclass(frozen=True, eq=False)
class Judged:
    """All pixels with depth and truth of one case: what supports their depth, and whether it is right."""

    case: str
    support: DepthSupport
    said: Array
    """Confidence of each pixel, by its own camera's misfit."""
    right: Array
    misfit_px: float | None
    cpu_s: float


def judge(case: str, images: Mapping[str, InputImage], truth: Mapping[str, Array]) -> Judged:
    """Compute depth from images, and compare it with its true depth (m, 0 = unknown) by camera."""
    calibrated = {name: image.calibrated for name, image in images.items()}
    checked = check_images(images)
    scene = find_rough_scene(calibrated)
    sources = choose_source_views({name: calibrated[name].view for name in scene.points}, scene.points)
    found = match_all_views(calibrated, sources, scene.depth_ranges, has_thin=scene.has_thin)
    begun = time.process_time()
    supports = dict(measure_support(calibrated, sources, found))
    cpu_s = (time.process_time() - begun) / len(found)
    known = {
        name: (view.depth > 0) & (truth[name] > 0) & ~images[name].outside for name, view in found.items()
    }
    talk(f"{case}: {len(found)} maps")
    said, _ = measure_confidence(images, sources, found, checked, 0.0)
    parts = [
        [part[known[n]] for part in (s.evidence, s.worth_px, np.asarray(s.rotation_gain), said[n])]
        for n, s in supports.items()
    ]
    evidence, worth_px, rotation_gain, sure = map(np.concatenate, zip(*parts, strict=True))
    return Judged(
        case,
        DepthSupport(evidence, worth_px, len(images), rotation_gain),
        sure.astype(np.float32),
        np.concatenate([right_depth(found[n].depth, truth[n])[known[n]] for n in known]),
        checked.error_px,
        cpu_s,
    )


def judge_scene(
    rendered: Rendered, condition: str, cameras: int | None, pose_error_px: float, draw: int = 0
) -> Judged:
    """Judge a scene, seen by its first cameras (None = all), which are turned by a draw of random angles."""
    shown: Condition = getattr(rendered, condition)
    rng = np.random.default_rng(3 + draw)
    views = {
        camera: _turned(view, rng.normal(0, pose_error_px / view.focal, 3))
        for camera, view in list(rendered.views.items())[:cameras]
    }
    images = {
        camera: undistort_image(camera, 0, shown.pictures[camera], view) for camera, view in views.items()
    }
    for camera, image in images.items():
        known = replace(image.calibrated, moving=dilate(shown.movers[camera], MARGIN_PX))
        images[camera] = replace(image, calibrated=known)
    fitted = ", fitted" if rendered.name.split()[0] in FITTED else ""
    return judge(f"{rendered.name}, {condition}, {len(views)} cameras{fitted}", images, shown.depth)


def _turned(view: View, angles: Array) -> View:
    turn = cv2.Rodrigues(angles)[0]
    return replace(view, rotation=turn @ view.rotation, translation=turn @ view.translation)


def judge_session(path: Path) -> Judged:
    """Judge one instant of a session with ground truth."""
    scene = Scene(Dataset.open(path))
    dataset = scene.dataset
    images, _ = InputImages(scene).usable(dataset.nearest_instants(INSTANT, ()))
    loaded = {n: undistorted_truth(dataset, one.view, n, one.instant) for n, one in images.items()}
    return judge(f"session {path.name}", images, {n: one[0] for n, one in loaded.items() if one is not None})


def reliability(draws: Sequence[Judged]) -> dict[str, Any]:
    """Return what was said and what is right, of all pixels of some draws and by range of confidence."""
    said = np.concatenate([one.said for one in draws])
    right = np.concatenate([one.right for one in draws])
    misfits_px = [one.misfit_px for one in draws if one.misfit_px is not None]
    row: dict[str, Any] = {"case": draws[0].case, "cpu_s": float(np.mean([one.cpu_s for one in draws]))}
    row |= {"misfit_px": float(np.median(misfits_px)) if misfits_px else None, "pixels": len(said)}
    row |= {"said": float(said.mean()), "right": float(right.mean()), "draws_error": None}
    if len(draws) > 1:
        off = [float(one.said.mean() - one.right.mean()) for one in draws]
        row["draws_error"] = float(np.std(off, ddof=1)) / len(draws) ** 0.5
    differences = []
    for low in RANGES:
        there = (said < low + 0.1 + (low == RANGES[-1])) & ((said >= low) | (low == RANGES[0]))
        if there.mean() >= MIN_SHARE:
            mine, true = float(said[there].mean()), float(right[there].mean())
            differences.append(true - mine)
            row[f"at_{low:.1f}"] = f"{100 * mine:.0f}: {100 * true:.0f}"
    return row | {"worst": max(differences, key=abs)}


def fit_right(judged: list[Judged]) -> dict[float, float]:
    """Return the fraction of right depths at each evidence of `RIGHT`, which never falls with evidence.

    It is of the pixels whose right match would give a right depth. Each case counts the same. Their
    calibrations are perfect, whatever their misfits are.
    """
    places = np.array([*RIGHT])
    right, measurable = np.zeros(len(places)), np.zeros(len(places))
    for one in judged:
        within = one.support.measurable(0.0)
        for k in range(len(places)):
            # A pixel between two places counts for both, the nearer one more.
            weights = np.interp(one.support.evidence, places, np.eye(len(places))[k])
            right[k] += float((weights * one.right).mean())
            measurable[k] += float((weights * within).mean())
    rising = np.maximum.accumulate(right / np.maximum(measurable, 1e-9))
    return {float(place): round(float(x), 2) for place, x in zip(places, rising, strict=True)}


def cases(
    scenes: Sequence[str],
    cameras: Sequence[int],
    pose_error_px: float,
    draws: int = 1,
    conditions: Sequence[str] = ("synced", "offset"),
) -> Iterator[list[Judged]]:
    """Yield the draws of the scenes, in two sizes and both conditions, by so many of their cameras."""
    for name in scenes:
        for size, shown in (((640, 480), ("synced",)), ((320, 240), ("synced", "offset"))):
            rendered = SCENES[name](*size)
            for condition in (one for one in shown if one in conditions):
                for count in cameras:
                    drawn = (judge_scene(rendered, condition, count, pose_error_px, k) for k in range(draws))
                    yield list(drawn)


def main() -> None:
    """Print a table, or JSON."""
    parser = new_parser(__doc__)
    parser.add_argument("--scene", action="append", choices=list(SCENES), help="[default: all]")
    parser.add_argument("--session", action="append", type=Path, help="with ground truth [default: samples]")
    parser.add_argument("--row", action="append", type=Path, help="a real row of cameras, not all else")
    parser.add_argument(
        "--cameras",
        action="append",
        type=int,
        help=f"of a scene [default: {CAMERAS}, of a row all]",
    )
    parser.add_argument("--pose-error", type=float, default=0.0, metavar="PX", help="of the scenes' cameras")
    parser.add_argument("--draws", type=int, default=1, help="of the pose error, counted as one case")
    parser.add_argument("--fit", action="store_true", help=f"to {' and '.join(FITTED)}, and print the table")
    asked = parser.parse_args()
    if asked.fit:
        print(fit_right([one for (one,) in cases(FITTED, FITTED_CAMERAS, 0.0, conditions=("synced",))]))
        return
    if asked.row:
        judged = [
            [judge_scene(read_row(folder), "synced", count, asked.pose_error, k) for k in range(asked.draws)]
            for folder in asked.row
            for count in asked.cameras or [None]
        ]
    else:
        scenes, counts = asked.scene or [*SCENES], asked.cameras or [CAMERAS]
        judged = list(cases(scenes, counts, asked.pose_error, asked.draws))
    if not asked.pose_error and not asked.cameras and not asked.row:
        judged += [[judge_session(path)] for path in asked.session or SESSIONS]
    rows = [reliability(draws) for draws in judged]
    print_report({"rows": rows}, lambda report: print_rows(report["rows"], COLUMNS), as_json=asked.json)


if __name__ == "__main__":
    main()
