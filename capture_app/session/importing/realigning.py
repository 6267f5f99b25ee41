"""Realignment of an imported session: its images are matched again by newly measured common times."""

from collections.abc import Mapping

import msgspec

from capture_app.common.errors import NotApplicableError
from capture_app.session.alignment.clock_line import compose
from capture_app.session.files.output_folder import OutputFolder
from capture_app.session.format.common_times import REFERENCE, CameraTimes, CommonTimes
from capture_app.session.importing.aligning import with_common_times
from capture_app.session.importing.frame_matching import TimedFrame, Timeline, timeline_by_times
from capture_app.session.importing.recording import missing_images
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter

_PRESERVED = ("sequence", "exposure_ns", "gain", "white_balance")
"""Fields of an image that are preserved, besides its bytes and its own time."""


def realign_session(session: Session, cameras: Mapping[str, CameraTimes], source: str) -> Session:
    """Change the times of an imported session's cameras; return the new one, which replaces it.

    `cameras` has each camera's offset and rate relative to its present times; `source` says for the manifest
    what they were found by.

    Raises NotApplicableError if it was not imported or stores its frames in videos; BadInputError and
    TryAgainError as writing a session does.
    """
    manifest, before = session.manifest, session.manifest.burst.common_times
    unknown = [f"{name}: {of.reason}" for name, of in cameras.items() if of.offset_ns is None]
    obstacles = (
        (
            manifest.origin != "imported",
            f"{manifest.name} was not imported: its times are not each camera's own",
            "leave out --apply: a captured session has measured times already",
        ),
        (manifest.videos, f"{manifest.name} stores its frames in videos", "import them again"),
        (
            unknown,
            f"not every camera's offset is known: {'; '.join(unknown)}",
            "import again with known offsets: --time-shift-ms CAMERA=MS",
        ),
    )
    for what, remedy in ((what, remedy) for applies, what, remedy in obstacles if applies):
        raise NotApplicableError(what, hint=remedy)
    together = {
        name: _since_own(of, before.cameras.get(name) if before else None) for name, of in cameras.items()
    }
    reference = next((name for name, of in cameras.items() if of.uncertainty_ns == 0), "")
    common = CommonTimes(state="aligned", reason=f"by {source}", reference=reference, cameras=together)
    timeline = with_common_times(_timeline(session), common)
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
        missing = missing_images(writer, [one.name for one in manifest.cameras], timeline.instants, None)
        writer.finish(manifest.cameras, burst, missing, manifest.origin, manifest.note)
    return Session.open(session.folder)


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
        frame = TimedFrame(place, own_ns, own_ns, {name: getattr(image, name) for name in _PRESERVED})
        cameras.setdefault(image.camera, []).append(frame)
    in_order = {name: sorted(of, key=lambda frame: frame.leader_ns) for name, of in cameras.items()}
    return timeline_by_times(session.manifest.name, in_order)


def _write_images(session: Session, timeline: Timeline, writer: SessionWriter) -> None:
    for number, instant in enumerate(timeline.instants):
        for name, frame in instant.frames.items():
            file = session.image_file(session.manifest.images[frame.index])
            writer.add_image(
                file.read_bytes(),
                camera=name,
                instant=number,
                suffix=file.suffix,
                leader_ns=frame.leader_ns,
                local_ns=frame.local_ns,
                residual_ns=frame.leader_ns - instant.leader_ns,
                **frame.further,
            )
