"""The images of a session being written; several threads may add images at once."""

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.session.files.durable import make_folders
from capture_app.session.format.journal import Journal
from capture_app.session.format.manifest import JOURNAL, ImageRecord
from capture_app.session.writing.recovery import recover_images

Key = tuple[str, int]
"""A camera and an instant."""


class ImageStore:
    """The images of one session being written; all methods may raise OSError."""

    def __init__(self, folder: Path, mutex: threading.RLock) -> None:
        """`mutex` is the writer's; `begin` and `wait_for_all` are called while it is held."""
        self._folder = folder
        self._records: dict[Key, ImageRecord] = {}
        self._under_way: set[Key] = set()
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

    def open(self, *, recover: bool) -> None:
        """Open the journal; with `recover`, first find the images that an interrupted writer has left."""
        if recover:
            images, damaged = recover_images(self._folder)
            self.damaged = tuple((image.camera, image.instant) for image in damaged)
            self._records = {(image.camera, image.instant): image for image in images}
        self._journal = Journal(self._folder / JOURNAL)

    def begin(self, record: ImageRecord) -> None:
        """Reserve the place of an image. Raises BadInputError where there is one already."""
        key = (record.camera, record.instant)
        if key in self._records or key in self._under_way:
            raise BadInputError(f"there is an image of {key[0]} at instant {key[1]} already")
        make_folders((self._folder / record.path).parent, self._folder)
        self._under_way.add(key)

    def save(self, record: ImageRecord, line: bytes, put: Callable[[Path], None]) -> None:
        """Let `put` write the file of an image that was begun, and add its line to the journal."""
        key, path = (record.camera, record.instant), self._folder / record.path
        assert self._journal is not None
        try:
            put(path)
            self._journal.note(line, path.parent)
        except OSError:
            with suppress(OSError):
                path.unlink()
            raise
        else:
            self._records[key] = record
        finally:
            with self._all_there:
                self._under_way.discard(key)
                self._all_there.notify_all()

    def wait_for_all(self) -> None:
        """Wait until no image is being saved."""
        while self._under_way:
            self._all_there.wait()

    def close(self) -> None:
        """Close the journal: all saved images are in it already."""
        if self._journal is not None:
            with suppress(OSError):
                self._journal.close()
