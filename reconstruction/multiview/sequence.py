"""`reconstruct multiview --instants`: a cloud of every instant, masks of what moves, a recording."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from capture_app.errors import BadInputError
from capture_app.optional_packages import load_optional
from capture_app.session.exporters.common.masks import mask_path
from capture_app.session.files.durable import write_atomic
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import CALIBRATION
from capture_app.terminal import Progress
from capture_app.text import pretty_json
from reconstruction.calibration.adoption import adopt_kept_calibration
from reconstruction.calibration.structure_from_motion import calibrate_from_images
from reconstruction.common.memory_budget import memory_budget
from reconstruction.common.native_libraries import library_versions, require_reconstruction
from reconstruction.multiview.instant_model import FUSED, MultiviewOptions, model_instant
from reconstruction.multiview.matcher import ChosenMatcher, choose_matcher
from reconstruction.multiview.recording import RECORDING, write_recording
from reconstruction.multiview.result import SequenceInstant, SequenceResult
from reconstruction.multiview.sequence_folder import (
    CLOUDS,
    DEPTH,
    MASKS,
    MESHES,
    RESULT,
    SequenceFolder,
    SequencePlan,
)
from reconstruction.session.conditions import Condition
from reconstruction.session.dataset import Dataset
from reconstruction.session.mover_detection import SceneMotion
from reconstruction.session.mover_masks import write_masks
from reconstruction.session.picture_checksums import picture_checks


@dataclass(frozen=True, kw_only=True)
class SequenceOptions:
    """Which instants, and what to make of each; `each` says the rest, its instant and offsets unused."""

    instants: Sequence[int] | None = None
    """None: all."""
    condition: Condition
    each: MultiviewOptions
    depth: bool = False
    """Keep the depth maps, too."""
    recording: bool = False


def model_sequence(
    session: Path, out: Path, options: SequenceOptions, progress: Progress | None = None
) -> SequenceResult:
    """Make a cloud of each instant in `out`; those that are there already are kept.

    An instant of which nothing can be made is left out, with the reason.

    Raises:
        BadInputError: the session or an instant cannot be used, `out` holds something else, or no instant
            gave a cloud.
        NotAvailableError: the matcher asked for, COLMAP, Open3D or Rerun is not here.
        TryAgainError: another run is writing to `out`.
    """
    began = time.perf_counter()
    require_reconstruction("pycolmap", "joining the cameras' depth")
    if options.each.mesh:
        require_reconstruction("open3d", "making meshes")
    if options.recording:
        load_optional("rerun", "rerun", "the .rrd format")
    matcher = choose_matcher(options.each.matcher)
    dataset = Dataset.open(session, options.each.time_shifts_ms)
    chosen = _chosen_instants(dataset, options.instants)
    adopt_kept_calibration(dataset)
    plan = SequencePlan(
        session=dataset.name,
        pictures=dataset.fingerprint(),
        condition=options.condition.name,
        time_shifts_ms=dict(options.each.time_shifts_ms),
        matcher=matcher.name,
        meshes=options.each.mesh,
        depth=options.depth,
    )
    with SequenceFolder(out, plan) as folder:
        progress = progress or Progress(1)
        masks = (out / MASKS).is_dir()
        wanted = not masks and all(len(dataset.instants(camera)) > 1 for camera in dataset.cameras)
        progress.total = len(dataset.cameras) * wanted + len(chosen) + options.recording
        if wanted:
            write_masks(dataset, folder.empty_work() / MASKS, progress)
            folder.take_over(MASKS)
            masks = True
        calibration = _calibrate(dataset, folder)
        earlier = {k: done for k in chosen if (done := folder.done(k)) is not None}
        progress.done += len(earlier)
        every = []
        for instant in chosen:
            if instant not in earlier:
                progress.step(f"instant {instant}")
            every.append(earlier.get(instant) or _make(dataset, matcher, options, instant, folder))
        if not any(one.cloud for one in every):
            raise BadInputError(f"no instant gave a cloud; the first: {every[0].reason}")
        if options.recording:
            progress.step("the recording")
            made = folder.empty_work() / RECORDING
            write_recording(made, out, dataset, calibration, [one for one in every if one.cloud])
            folder.take_over(RECORDING)
        result = _summary(dataset, plan, calibration, every)
        result = msgspec.structs.replace(
            result,
            kept=len(earlier),
            masks=masks,
            files=folder.files,
            seconds=round(time.perf_counter() - began, 3),
        )
        write_atomic(out / RESULT, pretty_json(result))
    return result


def cloud_file(instant: int) -> str:
    """Where the cloud of an instant is; the names are a sequence that viewers play."""
    return f"{CLOUDS}/{instant:06d}.ply"


def _chosen_instants(dataset: Dataset, asked: Sequence[int] | None) -> list[int]:
    count = len(dataset.instants_ns)
    chosen = sorted(set(range(count) if asked is None else asked))
    for instant in chosen:
        if not 0 <= instant < count:
            raise BadInputError(f"the session has no instant {instant}", hint=f"it has 0 to {count - 1}")
    return chosen


def _calibrate(dataset: Dataset, folder: SequenceFolder) -> Calibration:
    """The session's calibration, or one of its pictures, which all runs to this folder share."""
    calibration = dataset.calibration()
    if calibration is None:
        calibration = folder.calibration()
    if calibration is None:
        calibration = calibrate_from_images(dataset, SceneMotion(dataset, 1).widened_movers)
        write_atomic(folder.out / CALIBRATION, pretty_json(calibration))
    dataset.adopt_calibration(calibration)
    return calibration


def _make(
    dataset: Dataset, matcher: ChosenMatcher, options: SequenceOptions, instant: int, folder: SequenceFolder
) -> SequenceInstant:
    """Make an instant's files in a folder of their own, then give them their names; last that it is done."""
    work, out = folder.empty_work(), folder.out
    leader_ns = dataset.instants_ns[instant]
    try:
        offsets_ms = options.condition.offsets_ms(dataset.cameras, instant)
        wanted = replace(options.each, instant=instant, offsets_ms=offsets_ms)
        found = model_instant(dataset, matcher, wanted, work)
    except BadInputError as error:
        done = SequenceInstant(instant=instant, leader_ns=leader_ns, reason=str(error))
    else:
        _place(work / FUSED, out / cloud_file(instant))
        if options.each.mesh and found.mesh_triangles:
            _place(work / "mesh.ply", out / MESHES / f"{instant:06d}.ply")
        for view in found.views if options.depth else ():
            _place(work / view.depth, mask_path(out / DEPTH, view.camera, instant).with_suffix(".npz"))
        done = SequenceInstant(
            instant=instant,
            leader_ns=leader_ns,
            cloud=cloud_file(instant),
            points=found.fused_points,
            reference=found.reference,
            coverage=found.coverage,
            within_2pct=found.within_2pct,
            mover_within_2pct=found.mover_within_2pct,
            movers_1cm=found.movers_1cm,
            left_out=found.left_out,
            seconds=found.seconds,
        )
        folder.finish(done)
    return done


def _place(file: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(target, file.read_bytes())


def _summary(
    dataset: Dataset, plan: SequencePlan, calibration: Calibration, every: list[SequenceInstant]
) -> SequenceResult:
    scores = [one.movers_1cm.f_score for one in every if one.movers_1cm is not None]
    return SequenceResult(
        session=dataset.name,
        condition=plan.condition,
        matcher=plan.matcher,
        calibration=calibration.source_words,
        unit=calibration.unit,
        instants=tuple(every),
        clouds=sum(bool(one.cloud) for one in every),
        mover_f_score_1cm=_median(scores),
        mover_within_2pct=_median([one.mover_within_2pct for one in every]),
        within_2pct=_median([one.within_2pct for one in every]),
        files=(),
        seconds=0.0,
        memory_notes=memory_budget().notes,
        changed_pictures=picture_checks().changed,
        versions=library_versions(),
    )


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return round(float(np.median(known)), 4) if known else None
