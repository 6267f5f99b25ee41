"""Session recovery after a crash: find the intact images and move all others aside."""

import hashlib
from collections.abc import Container, Sequence
from contextlib import suppress
from pathlib import Path

import msgspec

from capture_app.common.errors import BadInputError
from capture_app.session.files.durable import PART, free_name, make_folders, sync_folder, write_atomic
from capture_app.session.files.untrusted_files import read_regular
from capture_app.session.format.journal import (
    TRUE_TIMES_JOURNAL,
    TrueTime,
    ground_truth_path,
    lines_of_file,
    record_of_line,
)
from capture_app.session.format.manifest import (
    IMAGES,
    JOURNAL,
    MANIFEST,
    ImageRecord,
    check_image_path,
)
from capture_app.session.format.stored_manifest import read_manifest
from capture_app.session.reading.checksums import changed_files

Key = tuple[str, int]
"""Camera name and instant of an image."""
SET_ASIDE = "set_aside"
"""Folder for images that are damaged or not in the journal."""
RESERVE = f"reserve{PART}"
"""File that reserves disk space for the manifest, so that a session can be finished on a full disk."""


def recover_images(folder: Path) -> tuple[dict[Key, ImageRecord], tuple[Key, ...]]:
    """Return the journal's intact images, and its damaged ones; afterwards it lists the intact ones only.

    Files that it does not list, or whose bytes changed, are moved into `set_aside`. Requires the session's
    lock. Raises OSError.
    """
    data = read_regular(folder / JOURNAL) if (folder / JOURNAL).exists() else b""
    records: dict[Key, ImageRecord] = {}
    for line in lines_of_file(data):
        if (listed := record_of_line(line, ImageRecord)) is not None:
            records.setdefault((listed.camera, listed.instant), listed)
    # An undamaged manifest takes precedence over the journal, which may be damaged.
    records |= {(record.camera, record.instant): record for record in _images_of_intact_manifest(folder)}
    safe = {key: record for key, record in records.items() if is_intact(folder, record)}
    (folder / RESERVE).unlink(missing_ok=True)
    _set_aside_all_but(folder, {record.path for record in safe.values()})
    journal = msgspec.json.Encoder().encode_lines(list(safe.values()))
    if journal != data:
        write_atomic(folder / JOURNAL, journal)
    return safe, tuple(key for key in records if key not in safe)


def _images_of_intact_manifest(folder: Path) -> Sequence[ImageRecord]:
    with suppress(BadInputError):
        if (folder / MANIFEST).is_file() and MANIFEST not in dict(changed_files(folder)):
            return read_manifest(folder / MANIFEST).images
    return ()


def is_intact(folder: Path, record: ImageRecord) -> bool:
    """Return whether an image's path is possible and its file has the recorded size and checksum."""
    try:
        check_image_path(record)
    except BadInputError:
        return False
    file = folder / record.path
    same_size = not file.is_symlink() and file.is_file() and file.stat().st_size == record.bytes
    return same_size and hashlib.sha256(file.read_bytes()).hexdigest() == record.sha256


def recover_true_times(folder: Path, images: Container[Key]) -> dict[Key, TrueTime]:
    """Return the known true times of these images."""
    path = folder / TRUE_TIMES_JOURNAL
    if not path.exists():
        return {}
    lines = lines_of_file(read_regular(path))
    intact = {
        (true.camera, true.instant): true
        for line in lines
        if (true := record_of_line(line, TrueTime)) is not None
        and (true.camera, true.instant) in images
        and _truth_is_intact(folder, true)
    }
    if len(intact) != len(lines):
        write_atomic(path, msgspec.json.Encoder().encode_lines(list(intact.values())))
    return intact


def _truth_is_intact(folder: Path, true: TrueTime) -> bool:
    file = folder / ground_truth_path(true.camera, true.instant)
    return true.sha256 is None or (
        file.is_file() and hashlib.sha256(file.read_bytes()).hexdigest() == true.sha256
    )


def _set_aside_all_but(folder: Path, intact: set[str]) -> None:
    for path in sorted((folder / IMAGES).rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name in intact or (path.is_dir() and not path.is_symlink()):
            continue
        if path.name.endswith(PART):
            path.unlink()
        else:
            set_aside(folder, name)


def set_aside(folder: Path, name: str) -> None:
    """Move a file of a session into its folder `set_aside`. Raises OSError."""
    aside = folder / SET_ASIDE / name
    make_folders(aside.parent, folder)
    (folder / name).replace(free_name(aside))
    sync_folder(aside.parent)
