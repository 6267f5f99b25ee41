"""Results to report: one with little in it, and one with everything, made of small grey pictures."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from capture_app.session.exporting.point_cloud import PointCloud, write_ply
from reconstruction.checks.bullet_time.bullet_time_study import BulletTime
from reconstruction.checks.poses.pose_study import PoseFacts
from reconstruction.method.comparison_results import (
    CompareResult,
    ConditionResult,
    OffsetTolerance,
)
from reconstruction.method.score import study_reports
from reconstruction.method.study_result import (
    Interval,
    Measure,
    Picture,
    StudyResult,
)
from reconstruction.method.timing import SessionTiming, Timing
from reconstruction.methods.multiview.multiview_study import MultiviewFacts
from reconstruction.pages.embedding import InstantClouds
from reconstruction.time_offsets.crossings import InstantOffset

TIMING = Timing(
    reference="cam2",
    other="cam3",
    synchronized=True,
    late_ms=0.1,
    uncertainty_ms=0.4,
    instants=tuple(InstantOffset(k, 0.1 * k, 0.3, 20) for k in range(5)),
)


def rig_timing(reference: str, *others: str) -> SessionTiming:
    """All of them together with the reference."""
    changes = ({"reference": reference, "other": other, "instants": ()} for other in others)
    return SessionTiming(
        reference=reference, cameras=tuple(msgspec.structs.replace(TIMING, **one) for one in changes)
    )


def unknown_rig_timing(reference: str, *others: str) -> SessionTiming:
    """The same, as own clips have it: sentences say why the last camera's offset is unknown."""
    why = (
        "moving things are 13.8 px apart where they should meet, and no other pairing of frames explains "
        "it: the calibration may be wrong, or a camera was moved between the calibration and this take"
    )
    *known, last = rig_timing(reference, *others).cameras
    unknown = msgspec.structs.replace(
        last, synchronized=False, late_ms=None, uncertainty_ms=None, reason=why, instants=()
    )
    return SessionTiming(reference=reference, cameras=(*known, unknown))


NASTY = "jump <script>alert('x')</script> & \"pinwheel\" $css {x}"


Values = Mapping[str, float | Interval | None]


def study(
    name: str, cameras: tuple[str, ...], synced: Values, offset: Values, **more: Any
) -> StudyResult[Any]:
    """A study that found these values in both conditions."""
    names = dict.fromkeys((*synced, *offset))
    measures = tuple(Measure(name=n, synced=known(synced.get(n)), offset=known(offset.get(n))) for n in names)
    return StudyResult(name=name, cameras=cameras, measures=measures, **{"instants": 5, **more})


def known(value: float | Interval | None) -> Interval | None:
    return Interval(value=value) if isinstance(value, int | float) else value


def changed(
    found: StudyResult[Any], synced: Values | None = None, offset: Values | None = None
) -> StudyResult[Any]:
    """A study with other values of some measures."""
    names = {one.name: one for one in found.measures}
    for side, values in (("synced", synced or {}), ("offset", offset or {})):
        for name, value in values.items():
            one = names.get(name, Measure(name=name))
            names[name] = msgspec.structs.replace(one, **{side: known(value)})
    return msgspec.structs.replace(found, measures=tuple(names.values()))


def changed_facts(found: StudyResult[Any], **changes: Any) -> StudyResult[Any]:
    """A study with other results of its own."""
    return msgspec.structs.replace(found, facts=msgspec.structs.replace(found.facts, **changes))


def skipped(name: str, why: str = "it was not requested") -> StudyResult[Any]:
    return StudyResult(name=name, skipped=why)


def with_studies(result: CompareResult, *studies: StudyResult[Any]) -> CompareResult:
    """The result with these studies instead of its own of their names."""
    found = {one.name: one for one in (*result.studies, *studies)}
    return msgspec.structs.replace(
        result, studies=tuple(found[name] for name in study_reports() if name in found)
    )


def found(result: CompareResult, name: str) -> StudyResult[Any]:
    """A study that the result has."""
    one = result.study(name)
    assert one is not None
    return one


DEPTH: Values = {
    "mover_coverage": 0.999,
    "static_coverage": 0.745,
    "mover_within_2pct": 0.981,
    "static_within_2pct": 0.673,
    "mover_epipolar_px": 0.26,
}
STEREO = study(
    "stereo",
    ("cam2", "cam3"),
    DEPTH,
    {
        "mover_coverage": 0.405,
        "static_coverage": 0.733,
        "mover_within_2pct": 0.0112,
        "static_within_2pct": 0.673,
        "mover_epipolar_px": 17.7,
    },
)
PANORAMA = study(
    "panorama",
    ("cam0", "cam4"),
    {"mover_misfit_px": 1.31, "static_overlap_mad": 4.2, "mover_overlap_mad": 6.1},
    {"mover_misfit_px": 23.4, "static_overlap_mad": 4.3, "mover_overlap_mad": 31.7},
)

RESULT = CompareResult(
    session=NASTY,
    offset_ms=66,
    offset_frames=2,
    actual_offset_ms=66.6,
    verdict="Synchronized cameras measure moving things. Late ones <do not>.",
    calibration="the session's own (calibration.json)",
    studies=(skipped("multiview"), STEREO, skipped("triangulation"), PANORAMA, skipped("poses")),
    timing=TIMING,
    rig_timing=rig_timing("cam2", "cam0", "cam3", "cam4"),
    sync_residual_us=85.2,
    sync_bound_us=1912,
    seconds=14.24,
    versions={"opencv": "5.0.0"},
)


def with_pictures(result: CompareResult, *pictures: Picture) -> CompareResult:
    return with_studies(result, msgspec.structs.replace(found(result, "stereo"), pictures=pictures))


CONDITIONS = ("synced", "offset")
CAMERAS = ("cam_left", "cam_middle", "cam_right")
LATE_MS = (0.0, 66.666, -33.333)
SHAPES = {"depth": (480, 640), "pano": (200, 2400), "upright": (900, 300)}
"""Height and width of the pictures with a slider, px."""
RANGED = Interval(value=0.9, low=0.871, high=0.925)


def grey(out: Path, name: str, shape: tuple[int, int], level: int) -> str:
    """Write a picture of one grey; its path relative to the folder."""
    path = f"pictures/{name}.png"
    (out / "pictures").mkdir(exist_ok=True)
    assert cv2.imwrite(str(out / path), np.full(shape, level, np.uint8))
    return path


def greys(out: Path, key: str, title: str, shape: tuple[int, int], *levels: int) -> Picture:
    """A picture of two greys, synchronized and offset."""
    paths = [grey(out, f"{key}_{side}", shape, level) for side, level in zip(CONDITIONS, levels, strict=True)]
    return Picture(key=key, title=title, synced=paths[0], offset=paths[1], caption="Bright is near.")


def clouds(out: Path) -> InstantClouds:
    """Clouds of a coloured ball, and of a wall where the ball is lost; their files lie in `out`."""
    rng = np.random.default_rng(1)
    around = rng.normal(size=(3_000, 3))
    ball = np.array([0, 0, 4.0]) + 0.8 * around / np.linalg.norm(around, axis=1, keepdims=True)
    wall = np.column_stack([rng.uniform(-2, 2, (3_000, 2)), np.full(3_000, 6.0)])
    paths = {}
    for side, points in (("synced", np.vstack([ball, wall])), ("offset", wall)):
        paths[side] = f"pictures/cloud_{side}.ply"
        colours = rng.integers(80, 255, points.shape).astype(np.uint8)
        write_ply(out / paths[side], PointCloud(points, colours))
    return InstantClouds(
        instant=2,
        **paths,
        rotation=(1, 0, 0, 0, 1, 0, 0, 0, 1),
        centre=(0, 0, 0),
        focal=0.9,
        pivot=(0, 0, 4),
    )


def whole_result(out: Path) -> CompareResult:
    """The result; its pictures lie in `out`."""
    depth: dict[str, Any] = {"mover_coverage": 0.9, "static_coverage": 0.7, "mover_within_2pct": RANGED}
    misfit = {"overlap_misfit_px": 1.3, "static_overlap_mad": 4.2}
    pictures = [greys(out, key, f"A picture of {key}", shape, 100, 180) for key, shape in SHAPES.items()]
    row = {
        "instant": 0,
        "mover_pixels": 2801,
        "synced_mover_coverage": 0.9,
        "offset_mover_coverage": 0.1,
        "synced_mover_epipolar_px": 0.1,
        "offset_mover_epipolar_px": 9.5,
    }
    stereo = study(
        "stereo",
        CAMERAS[:2],
        depth,
        depth,
        pictures=tuple(pictures),
        per_instant=(row,),
        commands={"synced": f"for k in 0 1; do reconstruct stereo {'/a/long/way' * 9} --instant $k; done"},
    )
    many: Values = {
        "mover_coverage": 0.98,
        "static_coverage": 0.9,
        "mover_within_2pct": 0.97,
        "static_within_2pct": 0.87,
        "mover_points": 12345.6,
        "static_points": Interval(value=98765, low=98123, high=99456),
        "mover_f_score": 0.81,
        "static_f_score": 0.7,
    }
    lost: Values = {**many, "mover_coverage": 0.052, "mover_within_2pct": 0.012, "mover_points": 45.0}
    multiview = study(
        "multiview",
        CAMERAS,
        many,
        lost,
        instants=3,
        per_instant=({"instant": 2, "synced_mover_points": 12345, "offset_mover_points": 45},),
        pictures=(greys(out, "multiview_depth", "Distance from all cameras", (96, 128), 90, 190),),
        facts=MultiviewFacts(
            reference=CAMERAS[1],
            tolerance_m=0.01,
            width_px=640,
            matcher="sweep",
            matcher_note="",
            left_out={"cam_dark": "its picture is black"},
            clouds=clouds(out),
        ),
    )
    poses = study(
        "poses",
        CAMERAS,
        {"registered": 3.0, "correct_pairs": 1.0, "rotation_deg": 0.05, "direction_deg": 0.4},
        {"registered": 2.5, "correct_pairs": 0.2, "rotation_deg": 27.0, "direction_deg": 40.0},
        offsets_ms=dict(zip(CAMERAS, LATE_MS, strict=True)),
        per_instant=(
            {"instant": 1, "synced_correct_pairs": 1.0, "offset_correct_pairs": 0.4},
            {"instant": 2, "synced_correct_pairs": 1.0, "offset_correct_pairs": 0.0},
        ),
        reason="71 % of the picture moves",
        facts=PoseFacts(degraded=True, tolerance_deg=2.0, truth_source="the simulated scene"),
    )
    panorama = study("panorama", CAMERAS[::2], misfit, misfit)
    sweep = {
        side: tuple(grey(out, f"sweep_{c}_{side}", (96, 128), 60 + 40 * k) for k, c in enumerate(CAMERAS))
        for side in CONDITIONS
    }
    grid = {
        "cameras": CAMERAS,
        "instants": list(range(8)),
        "times_ms": [33.3 * k for k in range(8)],
        "thumbnails": [
            [grey(out, f"burst_{name}_{k}", (60, 80), 20 * k) for k in range(8)] for name in CAMERAS
        ],
    }
    bullet_time = BulletTime(
        cameras=CAMERAS,
        instant=2,
        **sweep,
        offsets_ms=LATE_MS,
        stabilized=True,
        ordered_by_position=True,
        file="pictures/sweep.gif",
        synced_step_px=4.7,
        offset_step_px=18.7,
    )
    shown = (
        StudyResult(name="bullet_time", cameras=CAMERAS, instants=1, facts=bullet_time),
        StudyResult(name="burst", cameras=CAMERAS, instants=8, facts=grid),
    )
    timing = msgspec.structs.replace(TIMING, reference=CAMERAS[0], other=CAMERAS[1])
    return CompareResult(
        session="sessions/jump",
        timing=timing,
        rig_timing=rig_timing(*CAMERAS),
        offset_ms=66,
        offset_frames=2,
        actual_offset_ms=66.666,
        verdict="It matters. A lot.",
        calibration="given",
        studies=(multiview, stereo, skipped("triangulation"), panorama, poses, *shown),
        sync_residual_us=50,
        sync_bound_us=850,
        conditions=(ConditionResult(name="naive", session="sessions/naive", studies=(stereo,)),),
        tolerance=OffsetTolerance(
            cameras=CAMERAS[:2],
            measure="mover_within_2pct",
            points=tuple(
                study(
                    "stereo",
                    CAMERAS[:2],
                    depth,
                    depth,
                    offsets_ms=dict(zip(CAMERAS, (0.0, late), strict=False)),
                )
                for late in (0.0, 33.333, 66.666)
            ),
            instants=3,
            decreasing=True,
            timing=timing,
            tolerable_offset_ms=3.5,
            speed_px_per_ms=0.2,
            sync_residual_us=50,
            sync_residual_px=0.01,
        ),
        versions={"opencv": "5.0.0"},
    )
