"""The images of a session being written; several threads may add images at once.

An image that has come into a file of its own, and waits for its place in a session.
"""

import hashlib
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capture_app.errors import BadInputError
from capture_app.names import check_name
from capture_app.session.files.durable import make_folders_unsynced, sync_all, write_unsynced
from capture_app.session.format.checks import encode_checked
from capture_app.session.format.journal import Journal, JournalEntry
from capture_app.session.format.manifest import IMAGE_SUFFIXES, JOURNAL, ImageRecord, image_path
from capture_app.session.writing.recovery import recover_images

Key = tuple[str, int]
"""A camera and an instant."""


@dataclass(frozen=True, slots=True)
class NewImage:
    """An image that is to be saved."""

    record: ImageRecord
    line: bytes
    """Its record, as the journal has it."""
    put: Callable[[Path], object]
    """Gives the file its name; neither needs to be on the disk yet."""
    before: tuple[Path, ...] = ()
    """Further files and folders that must be on the disk before it counts."""

    @property
    def key(self) -> Key:
        """What tells it from the others."""
        return self.record.camera, self.record.instant


def new_image(
    data: bytes, *, camera: str, instant: int, leader_ns: int, suffix: str, **further: Any
) -> NewImage:
    """An image of these bytes. Raises BadInputError as `SessionWriter.add_image` does."""
    check_name(camera, "camera")
    if suffix not in IMAGE_SUFFIXES:
        raise BadInputError(
            f"{suffix!r} is not a supported image format", hint=f"use {', '.join(IMAGE_SUFFIXES)}"
        )
    if not data:
        raise BadInputError(f"camera {camera} sent an empty image of instant {instant}")
    record = ImageRecord(
        camera=camera,
        instant=instant,
        path=image_path(camera, instant, suffix),
        leader_ns=leader_ns,
        bytes=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
        **further,
    )
    return NewImage(record, encode_checked(record, ImageRecord), lambda path: write_unsynced(path, data))


class ImageStore:
    """The images of one session being written; all methods may raise OSError."""

    def __init__(self, folder: Path, mutex: threading.RLock) -> None:
        """`mutex` is the writer's; it is held while `begin`, `make_folders` and `wait_for_all` are called."""
        self._folder = folder
        self._records: dict[Key, ImageRecord] = {}
        self._under_way: set[Key] = set()
        self._changed_folders: frozenset[Path] = frozenset()
        """Those with new folders in them that are not known to be on the disk."""
        self._mutex = mutex
        self._all_there = threading.Condition(mutex)
        self._journal: Journal | None = None
        self.damaged: tuple[Key, ...] = ()
        """Images of a resumed session that were saved and are damaged now."""

    @property
    def records(self) -> tuple[ImageRecord, ...]:
        """The records of all images that are saved, by instant and camera."""
        return tuple(sorted(self._records.values(), key=lambda image: (image.instant, image.camera)))

    def get(self, camera: str, instant: int) -> ImageRecord | None:
        """The record of an image that is saved."""
        return self._records.get((camera, instant))

    def instants(self, camera: str) -> set[int]:
        """The instants of which a camera's image is saved."""
        return {instant for of, instant in self._records if of == camera}

    def open(self, *, recover: bool) -> None:
        """Open the journal; with `recover`, first find the images that an interrupted writer has left."""
        if recover:
            images, damaged = recover_images(self._folder)
            self.damaged = tuple((image.camera, image.instant) for image in damaged)
            self._records = {(image.camera, image.instant): image for image in images}
        self._journal = Journal(self._folder / JOURNAL)

    def begin(self, image: NewImage) -> None:
        """Reserve the place of an image. Raises BadInputError where there is one already."""
        if image.key in self._records or image.key in self._under_way:
            raise BadInputError(f"there is an image of {image.key[0]} at instant {image.key[1]} already")
        self.make_folders((self._folder / image.record.path).parent)
        self._under_way.add(image.key)

    def make_folders(self, folder: Path) -> None:
        """Make a folder in the session, which is on the disk once any image that is saved later is."""
        self._changed_folders |= set(make_folders_unsynced(folder, self._folder))

    def sync(self, paths: Iterable[Path]) -> None:
        """Wait until these files and folders, and all folders that were made, are on the disk."""
        for error in sync_all((*paths, *self._changed_folders)).values():
            raise error

    def save(self, images: Sequence[NewImage]) -> list[OSError | None]:
        """Put the files of images that were begun on the disk, and their lines into the journal.

        All at once: the disk is synced once for all of them, and for what other threads save at the same
        time. Returns what went wrong with each; that one is not in the session then.
        """
        assert self._journal is not None
        changed = self._changed_folders
        errors: list[OSError | None] = [None] * len(images)
        entries: list[JournalEntry | None] = [None] * len(images)
        try:
            for place, image in enumerate(images):
                path = self._folder / image.record.path
                try:
                    image.put(path)
                except OSError as error:
                    errors[place] = error
                    continue
                entries[place] = JournalEntry(image.line, (path, path.parent, *image.before, *changed))
            self._journal.note([entry for entry in entries if entry is not None])
        finally:
            self._note_saved(images, entries, errors, changed)
        return errors

    def wait_for_all(self) -> None:
        """Wait until no image is being saved."""
        while self._under_way:
            self._all_there.wait()

    def close(self) -> None:
        """Close the journal: all saved images are in it already."""
        if self._journal is not None:
            with suppress(OSError):
                self._journal.close()

    def _note_saved(
        self,
        images: Sequence[NewImage],
        entries: Sequence[JournalEntry | None],
        errors: list[OSError | None],
        changed: frozenset[Path],
    ) -> None:
        with self._mutex:
            for place, (image, entry) in enumerate(zip(images, entries, strict=True)):
                if entry is not None and entry.done and entry.error is None:
                    self._records[image.key] = image.record
                    self._changed_folders -= changed
                else:
                    errors[place] = errors[place] or (entry.error if entry is not None else None)
                    with suppress(OSError):
                        (self._folder / image.record.path).unlink()
                self._under_way.discard(image.key)
            self._all_there.notify_all()


@dataclass(frozen=True, slots=True)
class ReceivedImage:
    """Its file is on the session's disk and fits the record."""

    record: ImageRecord
    file: Path
    truth: bytes = b""
    """The .npz of a simulated image; empty for none."""
    true_ns: int | None = None
    """True start of the first row's exposure, of a simulated image."""

    def journal_line(self) -> bytes:
        """The record as the journal has it. Raises BadInputError for one that no session can hold."""
        record = self.record
        check_name(record.camera, "camera")
        suffix = Path(record.path).suffix
        if suffix not in IMAGE_SUFFIXES or record.path != image_path(record.camera, record.instant, suffix):
            raise BadInputError(f"{record.path!r} is not a valid path for an image of {record.camera}")
        return encode_checked(record, ImageRecord)
