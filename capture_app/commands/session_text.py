"""Sessions as text for people."""

from collections.abc import Iterator, Sequence
from statistics import median
from typing import Any

from capture_app.common.camera_facts import describe_stamp
from capture_app.common.grouping import grouped
from capture_app.common.templates import render_lines
from capture_app.common.text import duration
from capture_app.console.terminal import table
from capture_app.session.format.manifest import CameraRecord, ImageRecord, Manifest
from capture_app.session.library.listing import SessionCard
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import find_sync_record, judge, pixels, skipped_text


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


def list_lines(cards: Sequence[SessionCard]) -> Iterator[str]:
    """Yield a table of the sessions, and a line for each unusable one."""
    rows = [
        (
            *(session.shown, format_date(session.created)),
            *map(str, (len(session.cameras), session.instants, session.images, session.missing)),
            session.origin,
        )
        for session in cards
        if not session.problem
    ]
    if rows:
        yield table(("name", "taken (UTC)", "cameras", "instants", "images", "missing", "origin"), rows)
    yield from (
        f"unusable: {session.name}: {session.problem} ({session.remedy})"
        for session in cards
        if session.problem
    )


def session_lines(session: Session) -> Iterator[str]:
    """Describe a session: its cameras, their error bars, and the time differences within an instant."""
    manifest, sync = session.manifest, find_sync_record(session.manifest)
    of_instants = zip(sync.spread_ns, session.images_by_instant(), strict=True)
    instants_ns = manifest.burst.instants_ns
    yield from render_lines(
        "session.txt",
        __package__,
        manifest=manifest,
        created=format_date(manifest.created),
        span_ns=instants_ns[-1] - instants_ns[0] if instants_ns else 0,
        skipped=skipped_text(manifest.burst.skipped, manifest.labels),
        verdict=judge(manifest, arriving=session.is_arriving),
        is_calibrated=session.calibration() is not None,
        sync=sync,
        differences_ns=[spread_ns for spread_ns, images in of_instants if len(images) > 1],
        true_ns=_true_differences_ns(session),
        describe=_describe_differences,
        pixels=pixels,
    )
    yield ""
    images = grouped((image.camera, image) for image in manifest.images)
    yield table(
        ("camera", "size", "images", "95 % within", "hard bound", "off instant", "phase", "dropped"),
        [_camera_row(manifest, camera, images.get(camera.name, ())) for camera in manifest.cameras],
    )
    yield from render_lines(
        "session_cameras.txt", __package__, manifest=manifest, describe_stamp=describe_stamp
    )


def _describe_differences(differences_ns: Sequence[int]) -> str:
    middle_ns, max_ns = round(median(differences_ns)), max(differences_ns)
    return f"{duration(middle_ns)} apart at the median, {duration(max_ns)} at most"


def _true_differences_ns(session: Session) -> list[int]:
    """Return the true time difference of each instant's images, ns; empty if unknown."""
    truth = session.true_times()
    delays_ns = {camera.name: camera.delay_ns for camera in session.manifest.cameras}
    images = [image for image in (truth.images if truth else ()) if image.camera in delays_ns]
    # The offset between simulated and real cameras of one rig is unknown.
    if delays_ns.keys() != {image.camera for image in images}:
        return []
    times_ns = grouped((image.instant, image.true_ns - delays_ns[image.camera]) for image in images)
    return [
        max(own_times_ns) - min(own_times_ns) for own_times_ns in times_ns.values() if len(own_times_ns) > 1
    ]


def _camera_row(manifest: Manifest, camera: CameraRecord, images: Sequence[ImageRecord]) -> tuple[str, ...]:
    dropped = sum(missing.dropped for missing in manifest.missing if missing.camera == camera.name)
    return (
        manifest.labels[camera.name],
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
