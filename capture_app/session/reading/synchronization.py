"""How well a burst is synchronized: the record that the manifest keeps."""

from collections.abc import Iterable, Sequence
from itertools import groupby

from capture_app.camera_facts import unshared_uncertainties_ns
from capture_app.session.format.manifest import (
    BurstRecord,
    CameraRecord,
    ImageRecord,
    Manifest,
    MissingImage,
    SyncRecord,
)
from capture_app.session.format.row_exposures import row_exposures


def sync_record(
    cameras: Iterable[CameraRecord],
    burst: BurstRecord,
    images: Iterable[ImageRecord],
    missing: Sequence[MissingImage],
) -> SyncRecord:
    """Compute the sync record of a burst from its images' records, over all cameras and instants.

    The images of an instant must follow each other, as those of a manifest do: a recording has more of them
    than need be in memory.
    """
    by_name = {camera.name: camera for camera in cameras}
    facts = {name: camera.facts for name, camera in by_name.items()}
    # Times that were found from the pictures or the sound themselves are right whatever the stamps are.
    by_stamps = burst.common_times is None
    unshared_ns = unshared_uncertainties_ns(facts) if by_stamps else dict.fromkeys(facts, 0)
    spreads_ns = [0] * len(burst.instants_ns)
    rows_ns, errors, bounds = _Worst(), _Worst(), _Worst()
    substituted = late = 0
    for instant, group in groupby(images, key=lambda image: image.instant):
        of = list(group)
        spreads_ns[instant] = _spread([image.leader_ns for image in of])
        rows = _row_spread([(by_name[image.camera], image) for image in of])
        if rows is not None:
            rows_ns.add(rows)
        for image in of:
            known_ns = image.uncertainty_ns
            errors.add(None if known_ns is None else known_ns + unshared_ns[image.camera])
            bounds.add(image.hard_bound_ns)
            substituted += image.substitute
            late += image.late
    return SyncRecord(
        spread_ns=tuple(spreads_ns),
        row_spread_ns=rows_ns.value,
        uncertainty_ns=errors.value,
        hard_bound_ns=bounds.value,
        dropped=sum(gone.dropped for gone in missing),
        substituted=substituted,
        late=late,
    )


def computed_sync(manifest: Manifest) -> SyncRecord:
    """The sync record of a manifest's images, whatever their order and whatever record it keeps."""
    images = sorted(manifest.images, key=lambda image: image.instant)
    return sync_record(manifest.cameras, manifest.burst, images, manifest.missing)


class _Worst:
    """The largest of some numbers; None where any is not known, or there is none."""

    def __init__(self) -> None:
        self._largest: int | None = None
        self._all_known = True

    def add(self, number: int | None) -> None:
        """Take one in."""
        if number is None:
            self._all_known = False
        elif self._largest is None or number > self._largest:
            self._largest = number

    @property
    def value(self) -> int | None:
        """The largest so far."""
        return self._largest if self._all_known else None


def _spread(times_ns: Sequence[int]) -> int:
    return max(times_ns) - min(times_ns) if times_ns else 0


def _row_spread(images: Sequence[tuple[CameraRecord, ImageRecord]]) -> int | None:
    """The largest time between equal rows of the images: linear in the row, so the first and last suffice."""
    rows = [known for camera, image in images if (known := row_exposures(camera, image)) is not None]
    if len(rows) < 2:
        return None
    last = min(of.rows for of in rows) - 1
    return max(_spread([of.middle_ns(row) for of in rows]) for row in (0, last))
