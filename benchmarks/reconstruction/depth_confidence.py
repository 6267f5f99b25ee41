"""Reliability of depth's confidence: of pixels said to be right with some probability, how many are.

    python -m benchmarks.reconstruction.depth_confidence            the scenes and the sample sessions
    python -m benchmarks.reconstruction.depth_confidence --cameras 2 --cameras 3     the first ones of a scene
    python -m benchmarks.reconstruction.depth_confidence --pose-error 0.5 --draws 8  cameras turned, px
    python -m benchmarks.reconstruction.depth_confidence --row FOLDER       real images: see `camera_rows`
    python -m benchmarks.reconstruction.depth_confidence --rooms 72         rooms of `confidence_scenes`
    python -m benchmarks.reconstruction.depth_confidence --fit              `WEIGHTS`, by 180 other rooms
    python -m benchmarks.reconstruction.depth_confidence --fit-odds         `ODDS`, by `confidence_rooms.csv`

Right is within 2 % of the true depth. Each row counts the depths of all cameras with a truth; ranges with
under 1 % of a row's pixels are left out. Rooms are counted apart by whether their calibration could be
checked (if not, it counts as off by 0.5 px); and, with those taken as exact, by whether their kind was fitted
and by what is said. `held` is how often the interval of a room's reference camera contains what is right.
`--store FILE` appends rooms to such a file.

All depths of a rig share the error of its poses, so that only many draws of it can be judged together: `±` is
the standard error of said minus right by the draws, often 10 points with four to eight of them. The draws of
all scenes and pose errors are the same turns, so that rows share their luck. Simulated pictures, but for rows
of cameras.
"""

import contextlib
import csv
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from benchmarks.reconstruction.camera_rows import read_row
from benchmarks.reconstruction.confidence_scenes import FITTED, KINDS, draw_room
from benchmarks.reconstruction.multiview_scenes import SCENES, Condition, Rendered
from benchmarks.report import new_parser, print_report, print_rows, talk
from capture_app.common.errors import NotApplicableError
from capture_app.common.grouping import grouped
from reconstruction.common.geometry import Array, View
from reconstruction.depth.rough_scene import find_rough_scene
from reconstruction.depth.view_choice import choose_reference_view, choose_source_views
from reconstruction.method.truth import right_depth
from reconstruction.methods.multiview.confidence import (
    WEIGHTS,
    how_checked,
    measure_support,
    measure_terms,
)
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

SESSIONS = tuple(Path("sample_sessions") / name for name in ("jumper", "pinwheel", "naive"))
INSTANT = 2
RANGES = tuple(k / 10 for k in range(3, 10))
"""Lower ends of ranges of confidence, each 0.1 wide; the first one begins at 0."""
CAMERAS = 5
FIRST_FITTED = 2000
"""First seed of rooms that are fitted."""
FITTED_PIXELS = 4_000
OUTLYING = 0.1
"""Difference of said and right of a room from which it counts less in a fit."""
NEAR = 0.08
"""Largest difference of what is said and right of a row that counts as near."""
SURE = 0.7
"""Mean confidence that parts the rows of rooms, as those below it are far less near."""
MIN_SHARE = 0.01
STORED = Path(__file__).with_name("confidence_rooms.csv")
"""Rooms that `ODDS` are fitted to, each by its reference camera: of `--rooms 72 --first 500`, `--first 600`,
`--rooms 36 --first 3000 --pose-error 0.5` and `--fit --rooms 106`, those of more than two cameras."""
HELD = 0.95
"""Fraction of rooms whose right depth is in the interval that is said."""
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


SUMMARY = {
    "rooms": ("rooms", ""),
    "count": ("rows", ""),
    "near": (f"within {100 * NEAR:.0f} points", ".0%"),
    "mean": ("said minus right, mean", "+.1%"),
    "distance": ("mean distance", ".1%"),
    "too_sure": ("too sure", ""),
    "too_modest": ("too modest", ""),
    "held": ("held", ".0%"),
    "width": ("mean width", ".0%"),
}


class Reference(NamedTuple):
    """What is said of a rig's reference camera, and what is right; fractions of its pixels with depth."""

    case: str
    cameras: int
    misfit_px: float | None
    said: float
    right: float
    low: float = 0.0
    high: float = 1.0
    """Ends of the interval that is said."""


@dataclass(frozen=True, eq=False)
class Judged:
    """All pixels with depth and truth of one case: what is said of their depth, and whether it is right."""

    case: str
    cameras: int
    terms: Array
    """The terms of `WEIGHTS` (n, terms)."""
    said: Array
    """Confidence of each pixel, by its own camera's misfit."""
    exact: float
    """Mean confidence if a calibration that could not be checked counts as exact."""
    right: Array
    misfit_px: float | None
    cpu_s: float
    reference: Reference | None
    """None without depth."""


def judge(case: str, images: Mapping[str, InputImage], truth: Mapping[str, Array]) -> Judged:
    """Compute depth from images, and compare it with its true depth (m, 0 = unknown) by camera."""
    calibrated = {name: image.calibrated for name, image in images.items()}
    checked = check_images(images)
    scene = find_rough_scene(calibrated)
    sources = choose_source_views({name: calibrated[name].view for name in scene.points}, scene.points)
    depths = match_all_views(calibrated, sources, scene.depth_ranges, has_thin=scene.has_thin)
    matched = calibrated, sources, depths
    begun = time.process_time()
    supports = dict(measure_support(*matched))
    cpu_s = (time.process_time() - begun) / max(len(depths), 1)
    known = {
        name: (view.depth > 0) & (truth[name] > 0) & ~images[name].outside for name, view in depths.items()
    }
    talk(f"{case}: {len(depths)} maps")
    confidence = measure_confidence(images, sources, depths, checked, 0.0)
    said = {name: sure for name, (sure, _) in confidence.items()}
    right = {name: right_depth(depths[name].depth, truth[name])[known[name]] for name in known}
    reference = None
    if any(mask.any() for mask in known.values()):
        name = choose_reference_view({name: calibrated[name].view for name in depths}, scene.points)
        coverage = float((depths[name].depth > 0).mean())
        reference = Reference(
            case,
            len(images),
            checked.errors_px.get(name, checked.error_px),
            float(said[name][known[name]].mean()),
            float(right[name].mean()),
            *(end / coverage for end in confidence[name][1]),
        )
    terms = {
        name: np.stack([np.broadcast_to(terms[term], known[name].shape)[known[name]] for term in WEIGHTS], 1)
        for name, terms, _, _ in measure_terms(*matched)
    }
    exact = [
        support.confidence(checked.errors_px.get(name, checked.error_px) or 0.0)[known[name]]
        for name, support in supports.items()
    ]
    return Judged(
        case,
        len(images),
        np.concatenate([np.zeros((0, len(WEIGHTS))), *terms.values()]),
        np.concatenate([np.zeros(0), *(said[n][known[n]] for n in known)]),
        float(np.concatenate(exact).mean()) if exact else 0.0,
        np.concatenate([np.zeros(0), *right.values()]),
        checked.error_px,
        cpu_s,
        reference,
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
    turned = f", turned by {pose_error_px} px" if pose_error_px else ""
    return judge(f"{rendered.name}, {condition}, {len(views)} cameras{turned}", images, shown.depth)


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


def judge_rooms(kinds: Sequence[str], first: int, count: int, pose_error_px: float = 0.0) -> Iterator[Judged]:
    """Judge rooms of these kinds in turn, by seeds from the first one; those without depth are left out."""
    for seed in range(first, first + count):
        with contextlib.suppress(NotApplicableError):
            room = draw_room(kinds[seed % len(kinds)], seed)
            judged = judge_scene(room, "synced", None, pose_error_px, seed)
            if len(judged.right):
                yield judged


def fit_weights(rooms: Iterable[Judged]) -> dict[str, float]:
    """Return the weights by which these rooms' right depths are the most probable.

    Each room counts the same, but for those that are off by over `OUTLYING`, which count less: what no term
    shows would shift all others. Newton's method, with a slight pull to zero that decides between terms that
    say the same.
    """
    rng, samples = np.random.default_rng(0), list[tuple[Array, Array]]()
    for room in rooms:
        some = rng.integers(len(room.right), size=FITTED_PIXELS)
        samples.append((room.terms[some], room.right[some]))
    terms, right = map(np.stack, zip(*samples, strict=True))
    counted, pull = np.ones(len(right)), 1e-3 / len(right)
    weights = np.zeros(len(WEIGHTS))
    for _ in range(20):
        said = 1 / (1 + np.exp(-terms @ weights))
        wrong, doubt = (counted[:, None] * part / right.size for part in (right - said, said * (1 - said)))
        gradient = np.einsum("rpt,rp->t", terms, wrong) - pull * weights
        curvature = np.einsum("rpt,rp,rpu->tu", terms, doubt, terms, optimize=True)
        weights += np.linalg.solve(curvature + pull * np.eye(len(weights)), gradient)
        off = np.abs((said - right).mean(1))
        counted = np.minimum(OUTLYING / np.maximum(off, OUTLYING), 1) ** 2
    return {name: round(float(weight), 2) for name, weight in zip(WEIGHTS, weights, strict=True)}


def fit_odds(rooms: Iterable[Reference]) -> tuple[float, float]:
    """Return the factors of the odds said between which those of `HELD` of unseen rooms are.

    These are order statistics of the rooms' own factors (split conformal prediction, Vovk et al. 2005): half
    of the other rooms are beyond each.
    """
    odds = sorted(room.right * (1 - room.said) / ((1 - room.right) * room.said) for room in rooms)
    beyond = max(int((len(odds) + 1) * (1 - HELD) / 2), 1)
    return float(f"{odds[beyond - 1]:.2g}"), float(f"{odds[-beyond]:.2g}")


def fit_all_odds(rooms: Iterable[Reference]) -> dict[str, tuple[float, float]]:
    """Return the product's `ODDS`."""
    groups = grouped((how_checked(room.misfit_px), room) for room in rooms)
    return {name: fit_odds(its) for name, its in groups.items()}


def store_rooms(path: Path, rooms: Iterable[Judged]) -> None:
    """Append rooms of more than two cameras to a file."""
    with path.open("a", encoding="utf-8", newline="") as file:
        own = [room.reference for room in rooms if room.reference is not None and room.cameras > 2]
        csv.writer(file).writerows(
            [room.case, *(None if value is None else round(value, 4) for value in room[1:5])] for room in own
        )


def read_rooms(path: Path) -> list[Reference]:
    """Return the rooms of a file."""
    with path.open(encoding="utf-8", newline="") as file:
        return [
            Reference(case, int(cameras), float(px) if px else None, float(said), float(right))
            for case, cameras, px, said, right in csv.reader(file)
        ]


def summary(rooms: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return how near the rows of rooms are, by groups: each room of more than two cameras is in three."""
    groups: dict[str, list[tuple[float, Judged]]] = {}
    for room in rooms:
        said, right = float(room.said.mean()), float(room.right.mean())
        if room.cameras == 2:
            groups.setdefault("two cameras", []).append((said - right, room))
            continue
        checked = "checked" if room.misfit_px else "not checked"
        groups.setdefault(f"calibration {checked}", []).append((said - right, room))
        fitted = "fitted" if room.case.split()[0] in FITTED else "not fitted"
        said_of = f"{'over' if room.exact > SURE else 'up to'} {SURE:.0%} said"
        for group in (f"kinds {fitted}", said_of):
            groups.setdefault(f"{group}, exact if not checked", []).append((room.exact - right, room))
    return [_summed(group, rooms) for group, rooms in sorted(groups.items())]


def _summed(group: str, rooms: Sequence[tuple[float, Judged]]) -> dict[str, Any]:
    off = np.array([off for off, _ in rooms])
    own = [room.reference for _, room in rooms if room.reference is not None]
    return {
        "rooms": group,
        "count": len(off),
        "near": float((np.abs(off) <= NEAR).mean()),
        "mean": float(np.mean(off)),
        "distance": float(np.abs(off).mean()),
        "too_sure": int((off > NEAR).sum()),
        "too_modest": int((off < -NEAR).sum()),
        "held": float(np.mean([room.low <= room.right <= room.high for room in own])),
        "width": float(np.mean([room.high - room.low for room in own])),
    }


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


def print_rooms(report: dict[str, Any]) -> None:
    """Print the rows of rooms, and their summary."""
    print_rows(report["rows"], COLUMNS)
    print()
    print_rows(report["groups"], SUMMARY)


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
    parser.add_argument("--pose-error", type=float, default=0.0, metavar="PX", help="of cameras")
    parser.add_argument("--draws", type=int, default=1, help="of the pose error, counted as one case")
    parser.add_argument("--rooms", type=int, metavar="N", help="drawn rooms instead of all else")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="of the --rooms")
    parser.add_argument("--fit", action="store_true", help="to --rooms of other seeds [default: 180]")
    parser.add_argument("--fit-odds", action="store_true", help="of the interval, to `confidence_rooms.csv`")
    parser.add_argument("--store", type=Path, metavar="FILE", help="append rooms to such a file")
    asked = parser.parse_args()
    if asked.fit_odds:
        print(fit_all_odds(read_rooms(STORED)))
        return
    if asked.fit:
        fitted = list(judge_rooms([*FITTED], FIRST_FITTED, asked.rooms or 180))
        if asked.store:
            store_rooms(asked.store, fitted)
        print(fit_weights(room for room in fitted if room.cameras > 2))
        return
    if asked.rooms:
        rooms = list(judge_rooms([*KINDS], asked.first, asked.rooms, asked.pose_error))
        if asked.store:
            store_rooms(asked.store, rooms)
        report = {"rows": [reliability([room]) for room in rooms], "groups": summary(rooms)}
        print_report(report, print_rooms, as_json=asked.json)
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
