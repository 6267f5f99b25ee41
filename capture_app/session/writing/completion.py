"""The manifest that completes a session: reserves room for it, checks it and writes it."""

import heapq
from collections.abc import Iterable
from pathlib import Path

import msgspec

from capture_app.errors import BadInputError, IncompleteError
from capture_app.session.files.disk import reserve
from capture_app.session.files.durable import sync_all, write_atomic
from capture_app.session.format.burst_plan import BurstPlan
from capture_app.session.format.checks import check_references, encode_checked, indented
from capture_app.session.format.manifest import MANIFEST, ImageRecord, Manifest
from capture_app.session.reading.checksums import write_checksums
from capture_app.session.reading.reader import Session
from capture_app.session.reading.synchronization import sync_record
from capture_app.session.writing.recovery import RESERVE

RESERVED_BYTES = 1 << 16
RESERVED_BYTES_PER_IMAGE = 1500
"""What the manifest and the checksums may need."""
RESERVED_BYTES_PER_INSTANT, MOST_RESERVED_INSTANTS = 60, 400_000
"""The same of a recording, of which nobody knows how long it will be."""


def reserve_room(folder: Path, plan: BurstPlan) -> None:
    """Keep room on the disk for the manifest of a burst. Raises OSError where there is none."""
    instants = len(plan.instants_ns)
    if plan.streamed is not None and plan.streamed.video:
        needed = RESERVED_BYTES_PER_INSTANT * min(instants, MOST_RESERVED_INSTANTS)
    else:
        needed = RESERVED_BYTES_PER_IMAGE * len(plan.cameras) * instants
    reserve(folder / RESERVE, RESERVED_BYTES + needed)


def encode_manifest(folder: Path, manifest: Manifest, frames: Iterable[ImageRecord] = ()) -> bytes:
    """Add the sync record and encode; `frames` are those of its videos, in the order of their instants.

    Raises BadInputError where the records contradict each other.
    """
    encode_checked(manifest, Manifest)
    check_references(folder / MANIFEST, manifest)
    images = heapq.merge(manifest.images, frames, key=lambda image: image.instant)
    sync = sync_record(manifest.cameras, manifest.burst, images, manifest.missing)
    return indented(encode_checked(msgspec.structs.replace(manifest, sync=sync), Manifest))


def earlier_note(folder: Path) -> str:
    """The note of a manifest that is replaced: somebody may have written it since."""
    try:
        return Session.open(folder).stored_manifest.note
    except (BadInputError, IncompleteError):
        return ""


def write_manifest(folder: Path, data: bytes, before: Iterable[Path]) -> None:
    """Write the checksums and then the manifest, which makes the session complete. Raises OSError.

    The files and folders `before` it are synced first, all at once.
    """
    checksums = write_checksums(folder, data)
    for error in sync_all((*before, checksums, folder)).values():
        raise error
    write_atomic(folder / MANIFEST, data)
