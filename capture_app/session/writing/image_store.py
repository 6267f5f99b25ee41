"""Images of a session being written: each is a file, then a journal line, plus its ground truth."""

import hashlib
from collections.abc import Iterable, Mapping, Set
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from capture_app.common.clock import SimulatedClock
from capture_app.common.errors import SimulshotError
from capture_app.common.names import check_name
from capture_app.session.files.durable import (
    AppendOnlyFile,
    make_folders_unsynced,
    sync_all,
    write_atomic,
)
from capture_app.session.files.held_folder import HeldFolder
from capture_app.session.files.untrusted_files import encode_checked, indented
from capture_app.session.format.journal import (
    TIMES,
    TRUE_TIMES_JOURNAL,
    TrueTime,
    TrueTimes,
    ground_truth_path,
)
from capture_app.session.format.manifest import JOURNAL, ImageRecord, check_image_path
from capture_app.session.writing.recovery import Key, recover_images, recover_true_times, set_aside


@dataclass(frozen=True, slots=True)
class StoredImage:
    """An image or a video frame to be saved, with its ground truth if simulated."""

    record: ImageRecord
    data: bytes | memoryview
    """Bytes of the image's file."""
    truth: bytes | memoryview = b""
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
        return encode_checked(self.record, f"image {self.record.instant} of camera {self.record.camera}")


class ImageStore:
    """Images of one session being written, with their ground truth; the writer serializes all calls."""

    def __init__(self, held: HeldFolder) -> None:
        """Find the images that an interrupted writer left, and open the journal. Raises OSError."""
        self._held, folder = held, held.path
        self.records, self.damaged = recover_images(folder)
        """Records of all saved images by camera and instant, and the saved images that are now damaged."""
        self.is_crash_safe = False
        """Whether each true time is journaled on arrival; otherwise they are written with the manifest."""
        self.true_times = recover_true_times(folder, self.records)
        """True capture times of simulated images, by image."""
        self.clocks: dict[str, SimulatedClock] = {}
        """True clocks of the simulated cameras."""
        self._true_journal: AppendOnlyFile | None = None
        self._unsynced: dict[Key, tuple[ImageRecord, bytes, list[Path]]] = {}
        """Images that are written but not safe yet, each with its journal line and the paths to be synced."""
        self._new_folders: frozenset[Path] = frozenset()
        """Folders with new entries that are not synced yet, relative to the session."""
        self._journal = AppendOnlyFile(folder / JOURNAL)

    @property
    def _folder(self) -> Path:
        return self._held.path

    def append(self, images: Iterable[StoredImage]) -> None:
        """Write images and their ground truth, all or none; they are in the session after the next `sync`.

        Images that are here already are skipped. Raises OSError, and BadInputError if no session can contain
        one.
        """
        begun: dict[Key, tuple[ImageRecord, bytes, list[Path]]] = {}
        try:
            for image in images:
                if not any(image.key in known for known in (self.records, self._unsynced, begun)):
                    begun[image.key] = image.record, image.journal_line(), []
                    begun[image.key][2].extend(self._put(image))
        except (OSError, SimulshotError):
            self._delete(begun)
            raise
        self._unsynced |= begun

    def sync(self) -> None:
        """Sync what was appended, then its lines in the journal.

        Raises OSError; what was appended since the last sync is then not in the session.
        """
        if not (begun := self._unsynced):
            return
        self._unsynced = {}
        try:
            paths = [path for *_, written in begun.values() for path in written]
            for error in sync_all((*paths, *map(self._folder.joinpath, self._new_folders))).values():
                raise error
            self._new_folders = frozenset()
            self._journal.append(*(line for _, line, _ in begun.values()), durable=True)
        except OSError:
            self._delete(begun)
            raise
        self.records |= {key: record for key, (record, _, _) in begun.items()}

    def is_unsynced(self, camera: str, instant: int) -> bool:
        """Return whether an image was appended since the last sync."""
        return (camera, instant) in self._unsynced

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
        write_atomic(path, image.data, synced=False)
        return [*changed, path, path.parent]

    def _put_truth(self, camera: str, instant: int, true_ns: int, data: bytes | memoryview) -> list[Path]:
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
        inside = self._folder
        self._new_folders |= {new.relative_to(inside) for new in make_folders_unsynced(folder, inside)}

    def _delete(self, begun: Mapping[Key, tuple[ImageRecord, bytes, list[Path]]]) -> None:
        for key, (record, _, _) in begun.items():
            self.true_times.pop(key, None)
            with suppress(OSError):
                (self._folder / record.path).unlink()
