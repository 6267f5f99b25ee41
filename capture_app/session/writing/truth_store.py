"""Writes the ground truth of a simulated session, as safely as its images."""

import hashlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import msgspec

from capture_app.clock import SimulatedClock
from capture_app.session.files.durable import AppendOnlyFile, make_folders_unsynced, write_unsynced
from capture_app.session.format.checks import encode_checked, indented
from capture_app.session.format.ground_truth import (
    TIMES,
    TRUE_TIMES_JOURNAL,
    TrueTime,
    TrueTimes,
    ground_truth_path,
)
from capture_app.session.format.manifest import ImageRecord
from capture_app.session.writing.recovery import recover_true_times


class TruthStore:
    """The ground truth of one session being written; all methods may raise OSError."""

    def __init__(self, folder: Path, make_folders: Callable[[Path], None]) -> None:
        """`make_folders` makes a folder in the session, which `add` leaves to be synced."""
        self._folder = folder
        self._make_folders = make_folders
        self._times: dict[tuple[str, int], TrueTime] = {}
        self._clocks: dict[str, SimulatedClock] = {}
        self._journal: AppendOnlyFile | None = None

    @property
    def knows_times(self) -> bool:
        """Whether any image came with its true time."""
        return bool(self._times)

    def recover(self, images: Iterable[ImageRecord]) -> None:
        """Read the true times of these images that an interrupted writer has left."""
        self._times = recover_true_times(self._folder, images)

    def add(
        self, camera: str, instant: int, true_ns: int, *, data: bytes | None, crash_safe: bool
    ) -> tuple[Path, ...]:
        """Keep an image's true first-row time in ns of the host's clock, and its .npz where there is one.

        With `crash_safe` the time survives a crash; else it is written with the manifest only. Returns the
        files and folders that are still to be synced.
        """
        changed: tuple[Path, ...] = ()
        if data is not None:
            path = self._folder / ground_truth_path(camera, instant)
            self._make_folders(path.parent)
            write_unsynced(path, data)
            changed = path, path.parent
        sha256 = None if data is None else hashlib.sha256(data).hexdigest()
        true = TrueTime(camera=camera, instant=instant, true_ns=true_ns, sha256=sha256)
        self._times[camera, instant] = true
        if crash_safe:
            journal = self._folder / TRUE_TIMES_JOURNAL
            if self._journal is None:
                self._make_folders(journal.parent)
                self._journal = AppendOnlyFile(journal)
            self._journal.append(msgspec.json.encode(true), durable=False)
            changed = *changed, journal, journal.parent
        return changed

    def set_clocks(self, clocks: Mapping[str, SimulatedClock]) -> None:
        """Keep each camera's clock as it really is."""
        self._clocks = dict(clocks)

    def write(self) -> tuple[Path, ...]:
        """Write times.json, unless no true time and no clock is known; return what is still to be synced."""
        if not self._times and not self._clocks:
            return ()
        images = tuple(true for _, true in sorted(self._times.items()))
        times = TrueTimes(images=images, clocks=self._clocks)
        path = self._folder / TIMES
        changed = make_folders_unsynced(path.parent, self._folder)
        write_unsynced(path, indented(encode_checked(times, TrueTimes)))
        return path, path.parent, *changed

    def close(self) -> None:
        """Close the journal: all saved times are in it already."""
        if self._journal is not None:
            with suppress(OSError):
                self._journal.close(synced=False)
