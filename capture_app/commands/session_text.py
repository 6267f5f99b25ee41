"""Sessions in plain words, for people."""

from collections.abc import Sequence
from statistics import median

from capture_app.session.manifest import CameraRecord, ImageRecord, Manifest
from capture_app.session.reader import Session, SessionSummary


def list_text(found: Sequence[SessionSummary]) -> str:
    """One line a session."""
    rows = [("NAME", "TAKEN (UTC)", "CAMERAS", "INSTANTS", "IMAGES", "MISSING", "ORIGIN")]
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


def _spread(session: Session) -> list[str]:
    """How far apart in time the images of one instant are, first to last."""
    spreads = [
        max(image.leader_ns for image in images.values()) - min(image.leader_ns for image in images.values())
        for images in session.images_by_instant()
        if len(images) > 1
    ]
    if not spreads:
        return []
    sure = any(image.uncertainty_ns is not None for image in session.manifest.images)
    return [
        f"images of one instant are {_microseconds(round(median(spreads)))} apart at the median, "
        f"{_microseconds(max(spreads))} at most",
        *([] if sure else ["(by the times they came with; how sure those are is not known)"]),
    ]


def _camera(manifest: Manifest, camera: CameraRecord) -> tuple[str, ...]:
    images = [image for image in manifest.images if image.camera == camera.name]
    phase = camera.phase.residual_ns if camera.phase else None
    return (
        camera.name,
        f"{camera.width}x{camera.height}",
        str(len(images)),
        _worst([image.uncertainty_ns for image in images]),
        _worst([image.hard_bound_ns for image in images]),
        _worst_residual(images),
        "-" if phase is None else _microseconds(phase),
        str(sum(image.dropped for image in images)),
    )


def _worst(values: Sequence[int | None]) -> str:
    known = [value for value in values if value is not None]
    return _microseconds(max(known)) if known else "not known"


def _worst_residual(images: Sequence[ImageRecord]) -> str:
    return _microseconds(max((abs(image.residual_ns) for image in images), default=0))


def _microseconds(ns: int) -> str:
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
