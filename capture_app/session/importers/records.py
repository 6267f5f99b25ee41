"""The records of an imported session: those of the session that was exported, where it was one of ours."""

from collections.abc import Mapping, Sequence

import msgspec

from capture_app.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.session.format.common_times import CommonTimes
from capture_app.session.format.manifest import BurstRecord, CameraRecord, Manifest, MissingImage
from capture_app.session.importers.frame_matching import Instant, Timeline
from capture_app.session.importers.sources import Source
from capture_app.session.writing.session_writer import SessionWriter

IMPORTED = "imported"
_NO_FRAME = "the recording has no frame of it"


def camera_records(
    sources: Sequence[Source],
    sizes: Mapping[str, tuple[int, int]],
    timeline: Timeline,
    exported: Manifest | None,
) -> list[CameraRecord]:
    """A record of each camera; `sizes` are widths and heights in pixels."""
    known = {camera.name: camera for camera in exported.cameras} if exported else {}
    return [
        _same_camera(known[source.name], sizes[source.name])
        if source.name in known
        else CameraRecord(
            name=source.name,
            facts=CameraFacts(
                kind=IMPORTED,
                model=source.kind,
                width=sizes[source.name][0],
                height=sizes[source.name][1],
                period_ns=timeline.camera_periods_ns[source.name],
                timestamp_source=TimestampSource.UNKNOWN,
                phase_control=PhaseControl.NONE,
            ),
        )
        for source in sources
    ]


def burst_record(
    instants: Sequence[Instant], timeline: Timeline, common: CommonTimes | None, exported: Manifest | None
) -> BurstRecord:
    """The burst of these instants; that which was exported, if all of its instants are there."""
    times_ns = tuple(instant.leader_ns for instant in instants)
    if exported is not None and exported.burst.instants_ns == times_ns:
        return exported.burst
    common = exported.burst.common_times if exported else common
    return BurstRecord(instants_ns=times_ns, period_ns=timeline.period_ns, common_times=common)


def missing_images(
    writer: SessionWriter, names: Sequence[str], instants: Sequence[Instant], exported: Manifest | None
) -> list[MissingImage]:
    """What the session lacks, with the reasons."""
    dropped = _dropped(exported) if exported else set()
    missing = []
    for number, instant in enumerate(instants):
        for name in names:
            if writer.image(name, number):
                continue
            unreadable = "the frame could not be decoded" if name in instant.frames else _NO_FRAME
            reason = instant.why_missing.get(name, unreadable)
            lost = (name, instant.leader_ns) in dropped
            missing.append(MissingImage(camera=name, instant=number, reason=reason, dropped=lost))
    return missing


def origin_of(writer: SessionWriter, instants: Sequence[Instant], exported: Manifest | None) -> str:
    """The origin of a session: what was exported and came back bit for bit is still what it was."""
    if exported is None:
        return IMPORTED
    numbers = {at_ns: number for number, at_ns in enumerate(exported.burst.instants_ns)}
    recorded = {(image.camera, image.instant): image.sha256 for image in exported.images}
    for number, instant in enumerate(instants):
        for name in instant.frames:
            saved = writer.image(name, number)
            if saved is None or saved.sha256 != recorded.get((name, numbers.get(instant.leader_ns, -1))):
                return IMPORTED
    return exported.origin


def _same_camera(camera: CameraRecord, size: tuple[int, int]) -> CameraRecord:
    facts = msgspec.structs.replace(camera.facts, width=size[0], height=size[1])
    return msgspec.structs.replace(camera, facts=facts)


def _dropped(exported: Manifest) -> set[tuple[str, int]]:
    """Cameras, and the instants in ns whose frames they dropped."""
    times_ns = exported.burst.instants_ns
    return {(one.camera, times_ns[one.instant]) for one in exported.missing if one.dropped}
