"""Writing of a recording's instants as a session: images, records of cameras, what is missing and why."""

from collections.abc import Mapping, Sequence

from msgspec import structs

from capture_app.common.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.common.errors import BadInputError
from capture_app.common.text import Progress
from capture_app.session.format.common_times import CommonTimes
from capture_app.session.format.manifest import BurstRecord, CameraRecord, Manifest, MissingImage
from capture_app.session.importing.frame_matching import Instant, Timeline
from capture_app.session.importing.recording_sources import Source
from capture_app.session.writing.session_writer import SessionWriter

IMPORTED = "imported"
_NO_FRAME, _UNREADABLE = "the recording has no frame of it", "the frame could not be decoded"


def camera_records(
    sources: Sequence[Source],
    sizes: Mapping[str, tuple[int, int]],
    timeline: Timeline,
    exported: Manifest | None,
) -> list[CameraRecord]:
    """Return a manifest record of each source's camera.

    `exported` is the manifest of an exported session, whose own records are kept. `sizes` are widths and
    heights in px, by camera; `timeline` has the measured periods.
    """
    known = {
        camera.name: structs.replace(
            camera,
            facts=structs.replace(camera.facts, width=sizes[camera.name][0], height=sizes[camera.name][1]),
        )
        for camera in (exported.cameras if exported else ())
        if camera.name in sizes
    }
    return [
        known[source.name]
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
    """Return the burst record of these instants; an exported session with all its instants keeps its own."""
    times_ns = tuple(instant.leader_ns for instant in instants)
    if exported is not None and exported.burst.instants_ns == times_ns:
        return exported.burst
    return BurstRecord(
        instants_ns=times_ns,
        period_ns=timeline.period_ns,
        common_times=exported.burst.common_times if exported else common,
    )


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


def origin_of(writer: SessionWriter, instants: Sequence[Instant], exported: Manifest | None) -> str:
    """Return the origin of a session; an exported session with identical images keeps its origin."""
    if exported is None:
        return IMPORTED
    recorded = {
        (image.camera, exported.burst.instants_ns[image.instant]): image.sha256 for image in exported.images
    }
    saved = {
        (name, instant.leader_ns): writer.image(name, number)
        for number, instant in enumerate(instants)
        for name in instant.frames
    }
    same = all(image and image.sha256 == recorded.get(place) for place, image in saved.items())
    return exported.origin if same else IMPORTED


def first_sizes(sources: Sequence[Source], instants: Sequence[Instant]) -> dict[str, tuple[int, int]]:
    """Return width and height in px of each camera's first frame of these instants that can be decoded."""
    sizes: dict[str, tuple[int, int]] = {}
    for source in sources:
        indices = sorted(
            {instant.frames[source.name].index for instant in instants if source.name in instant.frames}
        )
        for _, _, size in source.frames(indices):
            sizes[source.name] = size
            break
    return sizes


def write_images(
    writer: SessionWriter,
    sources: Sequence[Source],
    instants: Sequence[Instant],
    uncertainty_ms: float | None,
    progress: Progress,
    *,
    own_times: bool,
) -> dict[str, tuple[int, int]]:
    """Save the frames of all instants; return width and height in px by camera.

    `uncertainty_ms` is the user's. `own_times`: the frames' times are each camera's own.
    """
    said = {} if uncertainty_ms is None else {"uncertainty_ns": round(uncertainty_ms * 1e6)}
    total, done = sum(len(instant.frames) for instant in instants), 0
    sizes: dict[str, tuple[int, int]] = {}
    for source in sources:
        numbers: dict[int, list[int]] = {}
        for number, instant in enumerate(instants):
            if source.name in instant.frames:
                numbers.setdefault(instant.frames[source.name].index, []).append(number)
        for index, data, size in source.frames(sorted(numbers)):
            if sizes.setdefault(source.name, size) != size:
                raise BadInputError(
                    f"{source.path} has images of {sizes[source.name]} and of {size} pixels",
                    hint="import the images of each size as a camera of its own",
                )
            for number in numbers[index]:
                instant, frame = instants[number], instants[number].frames[source.name]
                local_ns = frame.leader_ns if own_times else frame.local_ns
                writer.add_image(
                    data,
                    camera=source.name,
                    instant=number,
                    suffix=source.suffix,
                    leader_ns=frame.leader_ns,
                    residual_ns=frame.leader_ns - instant.leader_ns,
                    **{"local_ns": local_ns, "sequence": index, **frame.further, **said},
                )
            done += 1
            progress(done, total)
        if source.name not in sizes:
            raise BadInputError(
                f"{source.path} has no frame at any of the {len(instants)} instants",
                hint="leave this camera out, or correct its times, as with --time-shift-ms",
            )
    return sizes
