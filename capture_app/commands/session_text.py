"""Sessions as text for people."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from statistics import median
from typing import Any

from capture_app.common.camera_facts import describe_stamp
from capture_app.common.text import count, duration
from capture_app.console.terminal import table
from capture_app.session.format.common_times import REFERENCE, CameraTimes, CommonTimes
from capture_app.session.format.manifest import CameraRecord, Manifest
from capture_app.session.library.listing import SessionCard
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import PX_PER_S, find_sync_record, judge, pixels, skipped_text


def list_entry(card: SessionCard) -> dict[str, Any]:
    """Return a session's entry in JSON; `problem` is the reason why it cannot be used."""
    return {
        "path": str(card.folder),
        "name": card.name,
        "complete": card.state in ("complete", "unreadable"),
        "created": card.created,
        "origin": card.origin,
        "cameras": len(card.cameras),
        "instants": card.instants,
        "images": card.images,
        "missing": card.missing,
        "arriving": card.arriving,
        "problem": f"{card.problem} ({card.remedy})" if card.remedy else card.problem,
    }


def list_lines(found: Sequence[SessionCard]) -> Iterator[str]:
    """Yield a table of the sessions, and a line for each unusable one."""
    rows = [
        (
            *(session.name, format_date(session.created)),
            *map(str, (len(session.cameras), session.instants, session.images, session.missing)),
            session.origin,
        )
        for session in found
        if not session.problem
    ]
    if rows:
        yield table(("name", "taken (UTC)", "cameras", "instants", "images", "missing", "origin"), rows)
    yield from (
        f"unusable: {session.name}: {session.problem} ({session.remedy})"
        for session in found
        if session.problem
    )


def session_lines(session: Session) -> Iterator[str]:
    """Describe a session: its cameras, their error bars, and the time differences within an instant."""
    manifest = session.manifest
    instants = manifest.burst.instants_ns
    span_ns = instants[-1] - instants[0] if instants else 0
    yield f"{manifest.name}: {manifest.origin}, {format_date(manifest.created)} UTC, {manifest.software}"
    yield (
        f"{count(len(instants), 'instant')} over {duration(span_ns)}, "
        f"frames {manifest.burst.period_ns / 1e6:.3f} ms apart"
    )
    yield (
        f"{count(len(manifest.cameras), 'camera')}, {count(len(manifest.images), 'image')}, "
        f"{len(manifest.missing)} missing"
    )
    skipped, scatter = skipped_text(manifest.burst.skipped), _describe_scatter(session)
    verdict = judge(manifest, arriving=session.is_arriving)
    calibrated = "calibrated" if session.calibration() is not None else "not calibrated"
    yield from filter(None, (skipped, *scatter, verdict.headline, calibrated, manifest.note))
    yield ""
    yield table(
        ("camera", "size", "images", "95 % within", "hard bound", "off instant", "phase", "dropped"),
        [_camera_row(manifest, camera) for camera in manifest.cameras],
    )
    for camera in manifest.cameras:
        stamp = camera.facts.stamp
        if stamp is not None and not stamp.is_exact:
            yield f"{camera.name} stamps its frames {describe_stamp(stamp)}"
        for of in camera.widened:
            lasting = duration(of.until_local_ns - of.from_local_ns)
            yield f"{camera.name}, times of {lasting}: {of.reason}"
    missing = defaultdict[tuple[str, str], list[str]](list)
    for absence in manifest.missing:
        missing[absence.camera, absence.reason].append(str(absence.instant))
    for (name, reason), at in missing.items():
        named = ", ".join([*at[:8], "…"] if len(at) > 8 else at)
        yield f"{name} lacks {count(len(at), 'image')}: {reason} (instants {named})"


def _describe_scatter(session: Session) -> Iterator[str]:
    """Describe the time differences within an instant, and their effect."""
    manifest, times = session.manifest, session.manifest.burst.common_times
    if len(manifest.cameras) < 2 or not manifest.images:
        return
    verdict, sync = judge(manifest), find_sync_record(manifest)
    if times is not None and times.unknown:
        yield from (verdict.sentence, times.reason, *describe_common_times(times)[1:])
        return
    instants = zip(sync.spread_ns, session.images_by_instant(), strict=True)
    differences_ns = [difference_ns for difference_ns, images in instants if len(images) > 1]
    if not differences_ns:
        return
    by = "" if sync.uncertainty_ns is not None else "by the recorded times, "
    what = f"staggered: {manifest.steps}; beside these, images" if manifest.is_staggered else "images"
    apart = f"{by}{what} of one instant are {_describe_differences(differences_ns)}"
    if by and not any(differences_ns):
        apart = "how far images of one instant are apart is not known"
    yield from (
        apart,
        verdict.sentence,
        verdict.stamps,
    )
    if true_ns := _true_differences_ns(session):
        yield (
            f"by the ground truth they are {_describe_differences(true_ns)}: {pixels(max(true_ns), PX_PER_S)}"
        )
    if sync.row_spread_ns is not None and sync.row_spread_ns > 2 * max(sync.spread_ns):
        yield (
            "rolling shutter: rows of the same number are up to "
            f"{duration(sync.row_spread_ns)} apart, because readout times differ"
        )
    if times is not None:
        yield from describe_common_times(times)
    counts = ((sync.dropped, "dropped"), (sync.substituted, "substituted"), (sync.late, "late"))
    yield ", ".join(f"{number} {what}" for number, what in counts if number)


def describe_common_times(times: CommonTimes) -> list[str]:
    """Describe the source of an imported recording's times, and each camera's offset and rate."""
    return [times.words, *(f"  {name}: {_describe_times(camera)}" for name, camera in times.cameras.items())]


def _describe_times(times: CameraTimes) -> str:
    if times.offset_ns is None:
        return f"offset unknown: {times.reason}" if times.reason else "offset unknown"
    if times.source == REFERENCE:
        return "the reference"
    error = "" if times.uncertainty_ns is None else f" ± {times.uncertainty_ns / 1e6:.2f}"
    text = f"{times.offset_ns / 1e6:+.2f}{error} ms"
    if times.rate_uncertainty_ppm is not None:
        text += f", rate {times.rate_ppm:+.1f} ± {times.rate_uncertainty_ppm:.1f} ppm"
    return f"{text} (95 %), by {times.source}"


def _describe_differences(differences_ns: Sequence[int]) -> str:
    middle_ns, max_ns = round(median(differences_ns)), max(differences_ns)
    return f"{duration(middle_ns)} apart at the median, {duration(max_ns)} at most"


def _true_differences_ns(session: Session) -> list[int]:
    """Return the true time difference of each instant's images, ns; empty if unknown."""
    truth, times_ns = session.true_times(), defaultdict[int, list[int]](list)
    images = () if truth is None else truth.images
    # The offset between simulated and real cameras of one rig is unknown.
    if {camera.name for camera in session.manifest.cameras} <= {image.camera for image in images}:
        for image in images:
            times_ns[image.instant].append(image.true_ns - session.camera(image.camera).delay_ns)
    return [
        max(own_times_ns) - min(own_times_ns) for own_times_ns in times_ns.values() if len(own_times_ns) > 1
    ]


def _camera_row(manifest: Manifest, camera: CameraRecord) -> tuple[str, ...]:
    images = [image for image in manifest.images if image.camera == camera.name]
    dropped = sum(missing.dropped for missing in manifest.missing if missing.camera == camera.name)
    return (
        camera.name,
        f"{camera.facts.width}x{camera.facts.height}",
        str(len(images)),
        _worst([image.uncertainty_ns for image in images]),
        _worst([image.hard_bound_ns for image in images]),
        duration(max((abs(image.residual_ns) for image in images), default=0)),
        duration(camera.phase.residual_ns if camera.phase else None),
        str(sum(image.substitute for image in images) + dropped),
    )


def _worst(values: Sequence[int | None]) -> str:
    return duration(max((value for value in values if value is not None), default=None))


def format_date(created: str) -> str:
    """The date and time of day, UTC, of an RFC 3339 time."""
    return created[:19].replace("T", " ")
