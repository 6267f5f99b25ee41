"""Sessions in plain words, for people."""

from collections.abc import Sequence
from statistics import median

from capture_app.session.format.manifest import CameraRecord, ImageRecord, Manifest, SyncRecord
from capture_app.session.reading.reader import Session, SessionSummary
from capture_app.session.reading.synchronization import PX_PER_S, pixels, sync_record, verdict


def list_text(found: Sequence[SessionSummary]) -> str:
    """One line a session."""
    rows: list[tuple[str, ...]] = [
        ("NAME", "TAKEN (UTC)", "CAMERAS", "INSTANTS", "IMAGES", "MISSING", "ORIGIN")
    ]
    for one in found:
        if one.problem:
            continue
        counts = (str(n) for n in (one.cameras, one.instants, one.images, one.missing))
        rows.append((one.name, _taken(one.created), *counts, one.origin))
    lines = _columns(rows) if len(rows) > 1 else []
    return "\n".join([*lines, *(f"unusable: {one.problem}" for one in found if one.problem)])


def show_text(session: Session) -> str:
    """What a session holds: its cameras, their error bars, and how far apart the images of an instant are."""
    manifest = session.manifest
    instants = manifest.burst.instants_ns
    span_ns = instants[-1] - instants[0] if instants else 0
    lines = [
        f"{manifest.name}: {manifest.origin}, {_taken(manifest.created)} UTC, {manifest.software}",
        f"{_of(len(instants), 'instant')} over {span_ns / 1e6:.1f} ms, "
        f"frames {manifest.burst.period_ns / 1e6:.3f} ms apart",
        f"{_of(len(manifest.cameras), 'camera')}, {_of(len(manifest.images), 'image')}, "
        f"{len(manifest.missing)} missing",
        *_spread(session),
        "calibrated" if session.calibration() is not None else "not calibrated",
    ]
    if manifest.note:
        lines.append(manifest.note)
    head = ("CAMERA", "SIZE", "IMAGES", "SURE TO", "AT WORST", "OFF INSTANT", "PHASE", "DROPPED")
    rows = [head, *(_camera(manifest, camera) for camera in manifest.cameras)]
    lines += ["", *_columns(rows)]
    if manifest.missing:
        lines += ["", "missing:"]
        lines += [f"  {gone.camera}, instant {gone.instant}: {gone.reason}" for gone in manifest.missing[:12]]
        if len(manifest.missing) > 12:
            lines.append(f"  and {len(manifest.missing) - 12} more")
    return "\n".join(lines)


def sync_of(manifest: Manifest) -> SyncRecord:
    """The manifest's record of its synchronization; older ones lack it, but their images tell."""
    return manifest.sync or sync_record(manifest.cameras, manifest.burst, manifest.images, manifest.missing)


def _spread(session: Session) -> list[str]:
    """How far apart in time the images of one instant are, first to last, and what that costs."""
    manifest = session.manifest
    if len(manifest.cameras) < 2 or not manifest.images:
        return []
    sync = sync_of(manifest)
    images = session.images_by_instant()
    spreads = [spread for spread, of in zip(sync.spread_ns, images, strict=True) if len(of) > 1]
    if not spreads:
        return []
    by = "" if sync.uncertainty_ns is not None else "by the times they came with, "
    lines = [f"{by}images of one instant are {_apart(spreads)}", verdict(sync)]
    if true_spreads := _true_spreads(session):
        cost = pixels(max(true_spreads), PX_PER_S)
        lines.append(f"in truth, which the simulator knows, they are {_apart(true_spreads)}: {cost}")
    if sync.row_spread_ns is not None and sync.row_spread_ns > 2 * max(sync.spread_ns):
        lines.append(
            "rolling shutters: rows of the same number are up to "
            f"{_microseconds(sync.row_spread_ns)} apart, since not all cameras read out alike"
        )
    counts = ((sync.dropped, "dropped"), (sync.substituted, "substituted"), (sync.late, "late"))
    if any(count for count, _ in counts):
        lines.append(", ".join(f"{count} {what}" for count, what in counts if count))
    return lines


def _apart(spreads_ns: Sequence[int]) -> str:
    middle_ns, most_ns = round(median(spreads_ns)), max(spreads_ns)
    return f"{_microseconds(middle_ns)} apart at the median, {_microseconds(most_ns)} at most"


def _true_spreads(session: Session) -> list[int]:
    """For each instant, how far apart in ns its images truly are; empty where nobody knows."""
    true_times = session.true_times()
    times: dict[int, list[int]] = {}
    for true in true_times.images if true_times else ():
        times.setdefault(true.instant, []).append(true.true_ns)
    return [max(of) - min(of) for of in times.values()]


def _camera(manifest: Manifest, camera: CameraRecord) -> tuple[str, ...]:
    images = [image for image in manifest.images if image.camera == camera.name]
    phase = camera.phase.residual_ns if camera.phase else None
    dropped = sum(gone.dropped for gone in manifest.missing if gone.camera == camera.name)
    return (
        camera.name,
        f"{camera.width}x{camera.height}",
        str(len(images)),
        _worst([image.uncertainty_ns for image in images]),
        _worst([image.hard_bound_ns for image in images]),
        _worst_residual(images),
        "-" if phase is None else _microseconds(phase),
        str(sum(image.dropped for image in images) + dropped),
    )


def _worst(values: Sequence[int | None]) -> str:
    known = [value for value in values if value is not None]
    return _microseconds(max(known)) if known else "not known"


def _worst_residual(images: Sequence[ImageRecord]) -> str:
    return _microseconds(max((abs(image.residual_ns) for image in images), default=0))


def _microseconds(ns: int) -> str:
    if abs(ns) >= 10_000_000:
        return f"{ns / 1e6:,.0f} ms"
    return f"{ns / 1e3:,.0f} us" if abs(ns) >= 10_000 or ns == 0 else f"{ns / 1e3:.1f} us"


def _taken(created: str) -> str:
    return created[:19].replace("T", " ")


def _of(count: int, what: str) -> str:
    return f"{count} {what}" + ("" if count == 1 else "s")


def _columns(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
