"""Further conditions of a comparison, on the pairs already chosen: lists of offsets, another session."""

from dataclasses import dataclass
from pathlib import Path

from capture_app.terminal import Progress
from reconstruction.calibration.rig import Rig
from reconstruction.common.stage_cache import StageCache
from reconstruction.compare.all_cameras import AllCameras
from reconstruction.compare.depth_study import DepthStudy
from reconstruction.compare.panorama_study import PanoramaStudy
from reconstruction.scores.compare_results import ConditionResult
from reconstruction.scores.depth_results import StereoComparison
from reconstruction.scores.panorama_results import PanoramaComparison
from reconstruction.session.conditions import Condition
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import evenly_spread
from reconstruction.session.scene_motion import SceneMotion
from reconstruction.session.shown_instants import fixed_offsets_ms, pair_instants

Pair = tuple[str, str]


@dataclass(frozen=True)
class Chosen:
    """What the comparison has fixed: the pairs (None = there is none) and their synchronized results."""

    rig: Rig
    most_instants: int
    stereo: StereoComparison | None
    stitch: PanoramaComparison | None
    panorama: PanoramaStudy | None
    all_cameras: AllCameras


def judge(chosen: Chosen, condition: Condition) -> ConditionResult:
    """Score a condition against the synchronized one, on the same instants and pixels."""
    rig = chosen.rig
    stereo: StereoComparison | None = None
    stitched: PanoramaComparison | None = None
    late: dict[str, float | None] = {}
    skipped = []
    quiet = Progress(0, silent=True)
    if chosen.stereo is not None:
        cameras = (chosen.stereo.reference, chosen.stereo.other)
        try:
            pairs, late["stereo"] = _pairs(chosen, condition, cameras)
            study = DepthStudy(rig.dataset, rig.motion, rig.views, cameras, pairs, rig.unit)
            stereo = study.result(study.run(rig.stages, quiet), chosen.stereo.why)
        except ValueError as error:
            skipped.append(f"depth: {error}")
    if chosen.stitch is not None and chosen.panorama is not None:
        cameras = (chosen.stitch.cameras[0], chosen.stitch.cameras[1])
        try:
            pairs, late["stitch"] = _pairs(chosen, condition, cameras)
            whole = PanoramaStudy(rig.dataset, rig.motion, rig.views, cameras, pairs)
            whole.registration = chosen.panorama.registration
            stitched = whole.result(quiet, chosen.stitch.why)
        except ValueError as error:
            skipped.append(f"panorama: {error}")
    many, poses, missing = chosen.all_cameras.judge(condition, quiet)
    return ConditionResult(
        name=condition.name,
        offsets_ms=fixed_offsets_ms(condition, rig.dataset),
        stereo_offset_ms=late.get("stereo"),
        stitch_offset_ms=late.get("stitch"),
        stereo=stereo,
        stitch=stitched,
        multiview=many,
        poses=poses,
        skipped=(*skipped, *missing),
    )


def judge_session(chosen: Chosen, other: Dataset, folder: Path, step: int) -> ConditionResult:
    """Score another session's images of the same instant: by its own calibration, else by this one's."""
    motion = SceneMotion(other, step)
    theirs = Rig(other, motion, StageCache(folder, other.fingerprint()))
    quiet = Progress(0, silent=True)
    calibration = other.calibration() or chosen.rig.calibration
    if calibration is not None:
        theirs.use_calibration(calibration)
    stereo: StereoComparison | None = None
    stitched: PanoramaComparison | None = None
    skipped = []
    if chosen.stereo is not None and calibration is not None:
        cameras = (chosen.stereo.reference, chosen.stereo.other)
        try:
            study = DepthStudy(
                other, motion, theirs.views, cameras, _same(other, cameras, chosen), theirs.unit
            )
            judged = study.result(study.run(theirs.stages, quiet), "")
            stereo = StereoComparison(
                reference=cameras[0],
                other=cameras[1],
                synced=chosen.stereo.synced,
                offset=judged.synced,
                why=chosen.stereo.why,
            )
        except (ValueError, KeyError) as error:
            skipped.append(f"depth: {error}")
    if chosen.stitch is not None:
        cameras = (chosen.stitch.cameras[0], chosen.stitch.cameras[1])
        try:
            whole = PanoramaStudy(other, motion, theirs.views, cameras, _same(other, cameras, chosen))
            whole.register()
            stitched = PanoramaComparison(
                cameras=cameras,
                synced=chosen.stitch.synced,
                offset=whole.result(quiet, "").synced,
                why=chosen.stitch.why,
            )
        except (ValueError, KeyError) as error:
            skipped.append(f"panorama: {error}")
    many, poses, missing = chosen.all_cameras.judge_session(theirs)
    return ConditionResult(
        name=other.name,
        session=str(other.session.folder),
        stereo=stereo,
        stitch=stitched,
        multiview=many,
        poses=poses,
        skipped=(*skipped, *missing),
    )


def _pairs(chosen: Chosen, condition: Condition, cameras: Pair) -> tuple[list[tuple[int, int]], float | None]:
    found, late_ms = pair_instants(chosen.rig.dataset, condition, *cameras)
    return evenly_spread(found, chosen.most_instants), late_ms


def _same(other: Dataset, cameras: Pair, chosen: Chosen) -> list[tuple[int, int]]:
    there = [k for k in other.instants(cameras[0]) if other.has_image(cameras[1], k)]
    if not there:
        raise ValueError(f"{other.name} has no images of {cameras[0]} and {cameras[1]} of one instant")
    return evenly_spread([(k, k) for k in there], chosen.most_instants)
