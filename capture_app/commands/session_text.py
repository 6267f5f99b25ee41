"""Sessions in plain words, for people, on stdout."""

from collections import defaultdict
from collections.abc import Sequence
from statistics import median

from capture_app.session.format.common_times import REFERENCE, CameraTimes, CommonTimes
from capture_app.session.format.manifest import CameraRecord, Manifest
from capture_app.session.reading.reader import Session, SessionSummary
from capture_app.session.reading.stamp_words import describe_stamp
from capture_app.session.reading.verdict import PX_PER_S, find_sync_record, judge, pixels, skipped_text
from capture_app.terminal import print_line, print_table
from capture_app.text import count, duration


def print_sessions(found: Sequence[SessionSummary]) -> None:
    """Print one line a session, and what is wrong with those that cannot be used."""
    rows = []
    for one in (one for one in found if not one.problem):
        numbers = map(str, (one.cameras, one.instants, one.images, one.missing))
        rows.append((one.name, format_date(one.created), *numbers, one.origin))
    if rows:
        print_table(("name", "taken (UTC)", "cameras", "instants", "images", "missing", "origin"), rows)
    for one in found:
        if one.problem:
            print_line(f"unusable: {one.problem}")


def print_session(session: Session) -> None:
    """Print a session's cameras, their error bars, and how far apart the images of an instant are."""
    manifest = session.manifest
    instants = manifest.burst.instants_ns
    span_ns = instants[-1] - instants[0] if instants else 0
    lines = [
        f"{manifest.name}: {manifest.origin}, {format_date(manifest.created)} UTC, {manifest.software}",
        f"{count(len(instants), 'instant')} over {duration(span_ns)}, "
        f"frames {manifest.burst.period_ns / 1e6:.3f} ms apart",
        f"{count(len(manifest.cameras), 'camera')}, {count(len(manifest.images), 'image')}, "
        f"{len(manifest.missing)} missing",
        *filter(None, (skipped_text(manifest.burst.skipped),)),
        *_describe_spread(session),
        judge(manifest).headline,
        "calibrated" if session.calibration() is not None else "not calibrated",
    ]
    if manifest.note:
        lines.append(manifest.note)
    print_line("\n".join([*lines, ""]))
    head = ("camera", "size", "images", "95 % within", "hard bound", "off instant", "phase", "dropped")
    print_table(head, [_camera_row(manifest, camera) for camera in manifest.cameras])
    for camera in manifest.cameras:
        stamp = camera.facts.stamp
        if stamp is not None and not stamp.is_exact:
            print_line(f"{camera.name} stamps its frames {describe_stamp(stamp)}")
    if manifest.missing:
        print_line("\nmissing:")
        for gone in manifest.missing[:12]:
            print_line(f"  {gone.camera}, instant {gone.instant}: {gone.reason}")
        if len(manifest.missing) > 12:
            print_line(f"  and {len(manifest.missing) - 12} more")


def _describe_spread(session: Session) -> list[str]:
    """How far apart in time the images of one instant are, first to last, and what that costs."""
    manifest = session.manifest
    if len(manifest.cameras) < 2 or not manifest.images:
        return []
    times = manifest.burst.common_times
    if times is not None and times.unknown:
        return [judge(manifest).sentence, *describe_common_times(times)]
    sync = find_sync_record(manifest)
    images = session.images_by_instant()
    spreads = [spread for spread, of in zip(sync.spread_ns, images, strict=True) if len(of) > 1]
    if not spreads:
        return []
    by = "" if sync.uncertainty_ns is not None else "by the recorded times, "
    verdict = judge(manifest)
    lines = [f"{by}images of one instant are {_describe_spreads(spreads)}", verdict.sentence]
    if verdict.stamps:
        lines.append(verdict.stamps)
    if true_spreads := _true_spreads(session):
        cost = pixels(max(true_spreads), PX_PER_S)
        lines.append(f"by the ground truth they are {_describe_spreads(true_spreads)}: {cost}")
    if sync.row_spread_ns is not None and sync.row_spread_ns > 2 * max(sync.spread_ns):
        lines.append(
            "rolling shutter: rows of the same number are up to "
            f"{duration(sync.row_spread_ns)} apart, because readout times differ"
        )
    if times is not None:
        lines += describe_common_times(times)
    counts = ((sync.dropped, "dropped"), (sync.substituted, "substituted"), (sync.late, "late"))
    if any(number for number, _ in counts):
        lines.append(", ".join(f"{number} {what}" for number, what in counts if number))
    return lines


def describe_common_times(times: CommonTimes) -> list[str]:
    """What the times of an imported recording rest on, and each camera's offset and rate."""
    return [times.words, *(f"  {name}: {_describe_times(of)}" for name, of in times.cameras.items())]


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


def _describe_spreads(spreads_ns: Sequence[int]) -> str:
    middle_ns, most_ns = round(median(spreads_ns)), max(spreads_ns)
    return f"{duration(middle_ns)} apart at the median, {duration(most_ns)} at most"


def _true_spreads(session: Session) -> list[int]:
    """For each instant, how far apart in ns its images truly are; empty where nobody knows."""
    truth = session.true_times()
    if truth is None or not {camera.name for camera in session.manifest.cameras} <= {
        image.camera for image in truth.images
    }:
        # Of a rig of simulated and of real cameras it is not known how far apart they are.
        return []
    times_ns = defaultdict[int, list[int]](list)
    for image in truth.images:
        times_ns[image.instant].append(image.true_ns)
    return [max(of) - min(of) for of in times_ns.values() if len(of) > 1]


def _camera_row(manifest: Manifest, camera: CameraRecord) -> tuple[str, ...]:
    images = [image for image in manifest.images if image.camera == camera.name]
    dropped = sum(gone.dropped for gone in manifest.missing if gone.camera == camera.name)
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
