"""How well a burst is synchronized: the record that the manifest keeps."""

from collections.abc import Iterable, Sequence

from capture_app.session.format.manifest import (
    BurstRecord,
    CameraRecord,
    ImageRecord,
    MissingImage,
    SyncRecord,
)
from capture_app.session.format.row_exposures import row_exposures


def sync_record(
    cameras: Iterable[CameraRecord],
    burst: BurstRecord,
    images: Sequence[ImageRecord],
    missing: Sequence[MissingImage],
) -> SyncRecord:
    """Compute the sync record of a burst from its images' records, over all cameras and instants."""
    by_name = {camera.name: camera for camera in cameras}
    instants: list[list[ImageRecord]] = [[] for _ in burst.instants_ns]
    for image in images:
        instants[image.instant].append(image)
    row_spreads = [
        spread for of in instants if (spread := _row_spread([(by_name[i.camera], i) for i in of])) is not None
    ]
    return SyncRecord(
        spread_ns=tuple(_spread([image.leader_ns for image in of]) for of in instants),
        row_spread_ns=max(row_spreads, default=None),
        uncertainty_ns=_worst([image.uncertainty_ns for image in images]),
        hard_bound_ns=_worst([image.hard_bound_ns for image in images]),
        dropped=sum(gone.dropped for gone in missing),
        substituted=sum(image.substitute for image in images),
        late=sum(image.late for image in images),
    )


def _spread(times_ns: Sequence[int]) -> int:
    return max(times_ns) - min(times_ns) if times_ns else 0


def _row_spread(images: Sequence[tuple[CameraRecord, ImageRecord]]) -> int | None:
    """The largest time between equal rows of the images: linear in the row, so the first and last suffice."""
    rows = [known for camera, image in images if (known := row_exposures(camera, image)) is not None]
    if len(rows) < 2:
        return None
    last = min(of.rows for of in rows) - 1
    return max(_spread([of.middle_ns(row) for of in rows]) for row in (0, last))


def _worst(values: Sequence[int | None]) -> int | None:
    known = [value for value in values if value is not None]
    return max(known) if known and len(known) == len(values) else None
