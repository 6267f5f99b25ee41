"""Time offsets of all cameras of a session, from a blinking lamp if one is seen, else from motion."""

from math import comb
from pathlib import Path

from msgspec import Struct, structs

from capture_app.common import system
from capture_app.common.errors import BadInputError, NotApplicableError
from capture_app.console.terminal import Progress
from capture_app.session.format.camera_labels import require_camera
from capture_app.session.format.common_times import REFERENCE, CameraTimes
from capture_app.session.importing.realigning import realign_session
from capture_app.session.importing.realigning import repair_drops as repair_drops_of
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets.camera_time import CameraTime
from reconstruction.time_offsets.lamp import NO_LAMP, measure_light_offsets
from reconstruction.time_offsets.motion_alignment import align_cameras
from reconstruction.time_offsets.rig_offsets import MOTION, PARTNERS, measure_rig_offsets, with_own_changes
from reconstruction.time_offsets.single_images import repeated_images, stalled_images


class TimeResult(Struct, frozen=True, kw_only=True):
    """The measured time offsets, as `reconstruct time --json` prints them; `cameras` by name."""

    session: str
    reference: str
    cameras: dict[str, CameraTime]
    calibration: str
    seconds: float
    labels: dict[str, str] = {}
    """As in `Provenance`."""
    applied: bool = False
    """Whether the measured times were written into the session."""
    repaired: bool = False
    """Whether the images after dropped or repeated frames were paired again in the session."""


def measure_times(
    session: Path, reference: str | None = None, *, apply: bool = False, repair_drops: bool = False
) -> TimeResult:
    """Measure the time offsets of a session's cameras.

    Offsets of recordings without common times may be of any size. `apply` writes these times into the
    session. `repair_drops` pairs its images again where a camera dropped or repeated frames. Otherwise
    nothing is written.

    Raises:
        SimulshotError: the session cannot be used, has no such camera, or its cameras cannot be calibrated.
    """
    began = system.monotonic_s()
    scene = Scene.open(session)
    dataset = scene.dataset
    dataset.require_cameras(2, "a time offset is measured between two")
    if reference is not None:
        reference = require_camera(reference, dataset.labels, "--reference")
    alone = bool(dataset.unsynchronized)
    if apply and not alone:
        raise NotApplicableError(
            f"the cameras of {dataset.name} already have common times",
            hint="leave out --apply to measure their offsets",
        )
    if alone and repair_drops:
        raise NotApplicableError(
            f"the cameras of {dataset.name} have no common times yet",
            hint="align them first: reconstruct time SESSION --apply",
        )
    if alone and reference not in (None, dataset.cameras[0]):
        raise BadInputError(
            f"recordings without common times are measured against {dataset.cameras[0]}",
            hint=f"leave out --reference, or give --reference {dataset.cameras[0]}",
        )
    pairs = comb(len(dataset.cameras), 2)
    progress = Progress(2 + pairs if alone else 3 + min(pairs, PARTNERS * len(dataset.cameras)))
    if alone:
        _calibrate(scene, progress)
        aligned = align_cameras(scene, progress)
        cameras, calibration = {name: _aligned_time(offset) for name, offset in aligned.items()}, scene.source
    else:
        cameras, calibration = _common_times(scene, reference, progress)
    progress.last("offsets")
    if apply:
        realign_session(dataset.session, aligned, MOTION)
    if repair_drops:
        steps = {
            name: camera.change.steps
            for name, camera in cameras.items()
            if camera.change and camera.change.steps
        }
        if not steps:
            raise NotApplicableError(
                f"no dropped or repeated frame is found in {dataset.name}", hint="leave out --repair-drops"
            )
        repair_drops_of(
            dataset.session,
            {name: [(image.instant, image.frames) for image in step] for name, step in steps.items()},
        )
    reference = next(name for name, camera in cameras.items() if camera.source == REFERENCE)
    stalled = stalled_images(dataset, list(cameras))
    return TimeResult(
        session=str(session),
        reference=reference,
        cameras={
            name: _whole(dataset, reference, name, camera, stalled[name]).rounded()
            for name, camera in cameras.items()
        },
        calibration=calibration,
        labels=dataset.other_labels,
        seconds=system.monotonic_s() - began,
        applied=apply,
        repaired=repair_drops,
    )


def _common_times(
    scene: Scene, reference: str | None, progress: Progress
) -> tuple[dict[str, CameraTime], str]:
    """Return each camera's offset, from a lamp if it sees one, else from motion; and the calibration used."""
    progress.step("lamp")
    lit = measure_light_offsets(scene.dataset, reference)
    if not (unlit := [name for name, offset in lit.items() if offset.offset_ms is None]):
        return lit, ""
    if len(unlit) < len(lit):
        reference = next(name for name, offset in lit.items() if offset.source == REFERENCE)
    _calibrate(scene, progress)
    moved = with_own_changes(measure_rig_offsets(scene, reference, progress))
    for name in unlit:
        why, by_light = moved[name].reason, lit[name].reason
        both = why and by_light not in (NO_LAMP, why)
        lit[name] = CameraTime(reason=f"{why}; {by_light}") if both else moved[name]
    return lit, scene.source


def _whole(
    dataset: Dataset, reference: str, name: str, found: CameraTime, stalled: tuple[int, ...]
) -> CameraTime:
    """Return a camera's time with its planned delay, and its repeated and stalled images."""
    images = structs.replace(found.images, repeated=repeated_images(dataset, name), stalled=stalled)
    return structs.replace(found, images=images, planned_ms=dataset.planned_delay_ms(reference, name))


def _calibrate(scene: Scene, progress: Progress) -> None:
    progress.step("calibration")
    scene.calibration  # noqa: B018  (may take long, and may fail)


def _aligned_time(found: CameraTimes) -> CameraTime:
    if found.offset_ns is None or found.uncertainty_ns is None:
        return CameraTime(reason=found.reason)
    return CameraTime(
        offset_ms=found.offset_ns / 1e6,
        sd_ms=found.uncertainty_ns / 2e6,
        source=found.source,
        rate_ppm=found.rate_ppm,
        rate_sd_ppm=None if found.rate_uncertainty_ppm is None else found.rate_uncertainty_ppm / 2,
        at_ms=found.epoch_local_ns / 1e6,
    )
