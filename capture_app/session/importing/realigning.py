"""Realignment of an imported session: its images are matched again by newly measured common times."""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from capture_app.common.errors import NotApplicableError
from capture_app.session.alignment.clock_line import compose
from capture_app.session.files.output_folder import OutputFolder
from capture_app.session.format.common_times import REFERENCE, CameraTimes, CommonTimes
from capture_app.session.format.manifest import ImageRecord, Manifest, MissingImage
from capture_app.session.importing.frame_matching import (
    Instant,
    TimedFrame,
    Timeline,
    timeline_by_times,
    with_common_times,
)
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter

_NO_FRAME, _UNREADABLE = "the recording has no frame of it", "the frame could not be decoded"
_PRESERVED = ("sequence", "exposure_ns", "gain", "white_balance")
"""Fields of an image that are preserved, besides its bytes and its own time."""


def realign_session(session: Session, cameras: Mapping[str, CameraTimes], source: str) -> Session:
    """Change the times of an imported session's cameras; return the new one, which replaces it.

    `cameras` has each camera's offset and rate relative to its present times; `source` says for the manifest
    what they were found by.

    Raises NotApplicableError if it was not imported or stores its frames in videos; BadInputError and
    TryAgainError as writing a session does.
    """
    before = session.manifest.burst.common_times
    _require_images(session, "--apply")
    unknown = [f"{name}: {camera.reason}" for name, camera in cameras.items() if camera.offset_ns is None]
    if unknown:
        raise NotApplicableError(
            f"not every camera's offset is known: {'; '.join(unknown)}",
            hint="import again with known offsets: --time-shift-ms CAMERA=MS",
        )
    together = {
        name: _since_own(camera, before.cameras.get(name) if before else None)
        for name, camera in cameras.items()
    }
    reference = next((name for name, camera in cameras.items() if camera.uncertainty_ns == 0), "")
    common = CommonTimes(state="aligned", reason=f"by {source}", reference=reference, cameras=together)
    return _rewrite(session, with_common_times(_timeline(session), common), common)


def repair_drops(session: Session, steps: Mapping[str, Sequence[tuple[int, int]]]) -> Session:
    """Pair an imported session's images again where cameras dropped frames; return it, replaced.

    `steps` has for each camera the instants from which its images are later, and the number of frames that
    it dropped before, or repeated if negative. Raises as `realign_session`.
    """
    _require_images(session, "--repair-drops")
    manifest, period_ns = session.manifest, session.manifest.burst.period_ns
    cameras: dict[str, list[TimedFrame]] = {}
    for place, image in sorted(enumerate(manifest.images), key=lambda numbered: numbered[1].instant):
        later_ns = period_ns * sum(n for at, n in steps.get(image.camera, ()) if at <= image.instant)
        frames, at_ns = cameras.setdefault(image.camera, []), image.leader_ns + later_ns
        # Of the images of a repeated frame, the first has its time.
        if not frames or at_ns > frames[-1].leader_ns + period_ns // 2:
            own_ns = None if image.local_ns is None else image.local_ns + later_ns
            frames.append(TimedFrame(place, at_ns, own_ns, _preserved(image)))
    return _rewrite(session, timeline_by_times(manifest.name, cameras), manifest.burst.common_times)


def _require_images(session: Session, option: str) -> None:
    """Raise NotApplicableError if the session's images cannot be paired by other times."""
    manifest = session.manifest
    if manifest.origin != "imported":
        raise NotApplicableError(
            f"{manifest.name} was not imported: its times are not each camera's own",
            hint=f"leave out {option}: a captured session has measured times already",
        )
    if manifest.videos:
        raise NotApplicableError(f"{manifest.name} stores its frames in videos", hint="import them again")


def _rewrite(session: Session, timeline: Timeline, common: CommonTimes | None) -> Session:
    """Replace a session by one with its images at the instants of a timeline."""
    manifest = session.manifest
    with (
        OutputFolder(session.folder, lambda _: None) as output,
        SessionWriter(output.folder, manifest.name, manifest.created, manifest.software) as writer,
    ):
        _write_images(session, timeline, writer)
        if (calibration := session.calibration()) is not None:
            writer.set_calibration(calibration)
        burst = msgspec.structs.replace(
            manifest.burst,
            instants_ns=tuple(instant.leader_ns for instant in timeline.instants),
            common_times=common,
        )
        missing = missing_images(
            writer, [camera.name for camera in manifest.cameras], timeline.instants, None
        )
        writer.finish(
            manifest.cameras, burst, missing, manifest.origin, manifest.note, label=manifest.label or ""
        )
    return Session.open(session.folder)


def missing_images(
    writer: SessionWriter, names: Sequence[str], instants: Sequence[Instant], exported: Manifest | None
) -> list[MissingImage]:
    """Return the images that the session lacks, with the reasons."""
    times_ns = exported.burst.instants_ns if exported else ()
    absent = exported.missing if exported else ()
    dropped = {(absence.camera, times_ns[absence.instant]) for absence in absent if absence.dropped}
    return [
        MissingImage(
            camera=name,
            instant=number,
            reason=instant.why_missing.get(name, _UNREADABLE if name in instant.frames else _NO_FRAME),
            dropped=(name, instant.leader_ns) in dropped,
        )
        for number, instant in enumerate(instants)
        for name in names
        if not writer.image(name, number)
    ]


def _since_own(now: CameraTimes, before: CameraTimes | None) -> CameraTimes:
    """Return the conversion from a camera's own times to the new ones; `now` starts from `before`'s times.

    The uncertainty of `before` does not count: `now` was measured on the images themselves.
    """
    if before is None or before.offset_ns is None:
        return now
    if now.source == REFERENCE:
        return before
    return compose(
        now, msgspec.structs.replace(before, uncertainty_ns=0, rate_uncertainty_ppm=0.0, source=now.source)
    )


def _timeline(session: Session) -> Timeline:
    """Return the session's frames by their own times; a frame's index is its image's in the manifest."""
    cameras: dict[str, list[TimedFrame]] = {}
    for place, image in enumerate(session.manifest.images):
        own_ns = image.leader_ns if image.local_ns is None else image.local_ns
        cameras.setdefault(image.camera, []).append(TimedFrame(place, own_ns, own_ns, _preserved(image)))
    in_order = {name: sorted(camera, key=lambda frame: frame.leader_ns) for name, camera in cameras.items()}
    return timeline_by_times(session.manifest.name, in_order)


def _preserved(image: ImageRecord) -> dict[str, Any]:
    return {name: getattr(image, name) for name in _PRESERVED}


def _write_images(session: Session, timeline: Timeline, writer: SessionWriter) -> None:
    images = tuple(session.manifest.images)
    for number, instant in enumerate(timeline.instants):
        for name, frame in instant.frames.items():
            file = session.image_file(images[frame.index])
            writer.add_image(
                file.read_bytes(),
                camera=name,
                instant=number,
                suffix=file.suffix,
                leader_ns=frame.leader_ns,
                local_ns=frame.local_ns,
                residual_ns=frame.leader_ns - instant.leader_ns,
                synced=False,
                **frame.further,
            )
        writer.sync()
