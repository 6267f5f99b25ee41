"""Images of a session being written: each is a file, then a journal line, plus its ground truth."""

import hashlib
from collections.abc import Sequence, Set
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from capture_app.common.clock import SimulatedClock
from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.common.names import check_name
from capture_app.session.files.disk import disk_error, disk_errors
from capture_app.session.files.durable import (
    AppendOnlyFile,
    make_folders_unsynced,
    sync_all,
    write_atomic,
)
from capture_app.session.files.untrusted_files import encode_checked, indented
from capture_app.session.format.journal import (
    TIMES,
    TRUE_TIMES_JOURNAL,
    TrueTime,
    TrueTimes,
    ground_truth_path,
)
from capture_app.session.format.manifest import JOURNAL, ImageRecord, check_image_path, check_written
from capture_app.session.writing.recovery import Key, recover_images, recover_true_times, set_aside


@dataclass(frozen=True, slots=True)
class StoredImage:
    """An image or a video frame to be saved, with its ground truth if simulated."""

    record: ImageRecord
    source: Path | bytes | memoryview
    """The image's bytes, or a file on the session's disk that contains them."""
    truth: bytes = b""
    """Bytes of a simulated image's ground truth .npz; empty for none."""
    true_ns: int | None = None
    """True start of the first row's exposure of a simulated image, ns in the host's clock."""

    @property
    def key(self) -> Key:
        """Key of the image in its session: camera and instant."""
        return self.record.camera, self.record.instant

    def journal_line(self) -> bytes:
        """Encode the record as a journal line. Raises BadInputError if no session can contain it."""
        check_name(self.record.camera, "camera")
        check_image_path(self.record)
        check_written(self.record)
        return encode_checked(self.record)


class ImageStore:
    """Images of one session being written, with their ground truth; the writer serializes all calls."""

    def __init__(self, folder: Path) -> None:
        """Find the images that an interrupted writer left, and open the journal. Raises OSError."""
        self._folder = folder
        self.records, self.damaged = recover_images(folder)
        """Records of all saved images by camera and instant, and the saved images that are now damaged."""
        self.is_crash_safe = False
        """Whether each true time is journaled on arrival; otherwise they are written with the manifest."""
        self.true_times = recover_true_times(folder, self.records)
        """True capture times of simulated images, by image."""
        self.clocks: dict[str, SimulatedClock] = {}
        """True clocks of the simulated cameras."""
        self._true_journal: AppendOnlyFile | None = None
        self._new_folders: frozenset[Path] = frozenset()
        """Folders with new entries that are not synced yet."""
        self._journal = AppendOnlyFile(folder / JOURNAL)

    def save(self, images: Sequence[StoredImage]) -> list[SimulshotError | None]:
        """Write images and their ground truth to disk, then append their lines to the journal.

        All of them share one sync. Returns the error of each image; an image with an error is not in the
        session.
        """
        errors: list[SimulshotError | None] = [None] * len(images)
        begun: dict[Key, tuple[int, bytes, list[Path]]] = {}
        for place, image in enumerate(images):
            try:
                line = image.journal_line()
                if image.key in self.records or image.key in begun:
                    raise BadInputError("there is an image of {} at instant {} already".format(*image.key))
                with disk_errors(self._folder):
                    begun[image.key] = place, line, self._put(image)
            except SimulshotError as error:
                errors[place] = error
        failed = self._sync([path for _, _, paths in begun.values() for path in paths])
        for place, _, paths in begun.values():
            for path in failed.keys() & paths:
                errors[place] = disk_error(failed[path], self._folder)
        good = {place: line for place, line, _ in begun.values() if errors[place] is None}
        try:
            self._journal.append(*good.values(), durable=bool(good))
            self.records |= {images[place].key: images[place].record for place in good}
        except OSError as error:
            for place in good:
                errors[place] = disk_error(error, self._folder)
        for place, _, _ in begun.values():
            if errors[place] is not None:
                with suppress(OSError):
                    (self._folder / images[place].record.path).unlink()
        return errors

    def leave_out(self, cameras: Set[str]) -> None:
        """Set aside the images of these cameras. Raises OSError."""
        refused = [key for key in self.records if key[0] in cameras]
        for key in refused:
            set_aside(self._folder, self.records.pop(key).path)
            self.true_times.pop(key, None)
        if refused:
            self._journal.close()
            write_atomic(
                self._folder / JOURNAL, msgspec.json.Encoder().encode_lines(list(self.records.values()))
            )
            self._journal = AppendOnlyFile(self._folder / JOURNAL)

    def close(self) -> None:
        """Close the journals, which already contain all saved images."""
        self._journal.close()
        if self._true_journal is not None:
            self._true_journal.close()

    def write_truth(self) -> tuple[Path, ...]:
        """Write times.json, unless no true time and no clock is known; return the paths still to be synced.

        Raises OSError.
        """
        if not self.true_times and not self.clocks:
            return ()
        images = tuple(true for _, true in sorted(self.true_times.items()))
        path = self._folder / TIMES
        changed = make_folders_unsynced(path.parent, self._folder)
        write_atomic(
            path, indented(encode_checked(TrueTimes(images=images, clocks=self.clocks))), synced=False
        )
        return path, path.parent, *changed

    def _put(self, image: StoredImage) -> list[Path]:
        """Move an image's file to its final name and store its ground truth; return paths to be synced."""
        path = self._folder / image.record.path
        changed = [] if image.true_ns is None else self._put_truth(*image.key, image.true_ns, image.truth)
        self._make(path.parent)
        if isinstance(image.source, Path):
            image.source.replace(path)
        else:
            write_atomic(path, image.source, synced=False)
        return [*changed, path, path.parent]

    def _put_truth(self, camera: str, instant: int, true_ns: int, data: bytes) -> list[Path]:
        """Store an image's true first-row time (ns, host's clock), and its .npz if there is one."""
        changed, sha256 = [], hashlib.sha256(data).hexdigest() if data else None
        if data:
            path = self._folder / ground_truth_path(camera, instant)
            self._make(path.parent)
            write_atomic(path, data, synced=False)
            changed = [path, path.parent]
        true = TrueTime(camera=camera, instant=instant, true_ns=true_ns, sha256=sha256)
        self.true_times[camera, instant] = true
        if self.is_crash_safe:
            journal = self._folder / TRUE_TIMES_JOURNAL
            if self._true_journal is None:
                self._make(journal.parent)
                self._true_journal = AppendOnlyFile(journal)
            self._true_journal.append(msgspec.json.encode(true), durable=False)
            changed += [journal, journal.parent]
        return changed

    def _make(self, folder: Path) -> None:
        self._new_folders |= set(make_folders_unsynced(folder, self._folder))

    def _sync(self, paths: list[Path]) -> dict[Path, OSError]:
        """Sync these files and folders, and the new folders; return the errors by path.

        If a new folder fails, every path counts as failed.
        """
        failed = sync_all((*paths, *self._new_folders))
        self._new_folders &= failed.keys()
        for folder in self._new_folders:
            failed |= dict.fromkeys(paths, failed[folder])
        return failed
