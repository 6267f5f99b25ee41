"""Videos of a session being written: frames are appended, and count once they and their lines are synced.

A camera's video has parts, as some disks have a largest file: FAT32's is just below 4 GiB.
"""

import heapq
import os
import shutil
import threading
from array import array
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterable, Iterator, Set
from contextlib import suppress
from dataclasses import dataclass, field
from errno import EFBIG, ENOENT
from itertools import chain, groupby, repeat, takewhile
from pathlib import Path

import msgspec

from capture_app.common import system
from capture_app.common.errors import SimulshotError
from capture_app.common.names import check_name
from capture_app.session.files.durable import (
    AppendOnlyFile,
    free_name,
    make_folders,
    sync_folder,
    write_all,
    write_atomic,
)
from capture_app.session.files.held_folder import HeldFolder
from capture_app.session.format.journal import (
    FRAMES_SUFFIX,
    frame_line,
    frame_of_line,
    frames_path,
    record_of_line,
)
from capture_app.session.format.manifest import (
    NO_INSTANT,
    VIDEOS,
    FrameRecord,
    VideoRecord,
    video_of,
    video_path,
)
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.recovery import SET_ASIDE, set_aside

MAX_PART_BYTES = 4_000_000_000
"""Size from which on a camera's frames go into the next part of its video."""


@dataclass(slots=True)
class _Part:
    """One part of a camera's video; memory holds only the offset of each frame's line."""

    number: int
    handle: int
    lines: AppendOnlyFile
    record: VideoRecord
    instants: "array[int]" = field(default_factory=lambda: array("Q"))
    """Instants of its frames, in order."""
    starts: "array[int]" = field(default_factory=lambda: array("Q"))
    """Byte offset of each frame's line."""
    length: int = 0
    """Total length of all lines, bytes."""
    unsynced: list[tuple[int, bytes, int]] = field(default_factory=list)
    """Appended frames that are not safe yet: instant, line, and end in the video."""

    @property
    def end(self) -> int:
        """End of the last appended frame."""
        return self.unsynced[-1][2] if self.unsynced else self.record.bytes

    def find(self, instant: int) -> int | None:
        """Return the index of an instant's frame, or None."""
        place = bisect_left(self.instants, instant)
        return place if place < len(self.instants) and self.instants[place] == instant else None

    def truncate(self) -> None:
        """Remove what was written after the last appended frame."""
        with suppress(OSError):
            os.ftruncate(self.handle, self.end)

    def close(self) -> None:
        """Close both files; may be called twice."""
        if self.handle >= 0:
            os.close(self.handle)
            self.handle = -1
        self.lines.close()

    def note(self, instant: int, line_bytes: int, frame_end: int) -> None:
        """Record a frame's line, and the end of the frame."""
        if instant != NO_INSTANT and self.find(instant) is None:
            place = bisect_left(self.instants, instant)
            self.instants.insert(place, instant)
            self.starts.insert(place, self.length)
        self.length += line_bytes
        self.record = msgspec.structs.replace(self.record, frames=self.record.frames + 1, bytes=frame_end)


class VideoStore:
    """Videos of one session; methods may raise OSError, and may be called from any thread."""

    def __init__(self, held: HeldFolder) -> None:
        """Adopt the videos that an interrupted writer left.

        A torn line is dropped, and bytes after the last frame with a line are set aside.
        """
        self._held = held
        self._videos: dict[str, list[_Part]] = {}
        """Parts of each camera's video; all but the last are closed."""
        self._writing = defaultdict[str, threading.Lock](threading.Lock)
        """Held while a camera's files are written or synced."""
        self._mutex = threading.Lock()
        self.knows_true_times = False
        """Whether any frame came with its true time."""
        files = (held.path / VIDEOS).glob(f"*/*{FRAMES_SUFFIX}")
        paths = {video_of(lines.name.removesuffix(FRAMES_SUFFIX)): lines for lines in files}
        for (camera, number), lines in sorted(paths.items()):
            self._recover(camera, number, lines)

    @property
    def _folder(self) -> Path:
        return self._held.path

    def has(self, camera: str, instant: int) -> bool:
        """Return whether a camera's video has the frame of an instant."""
        with self._mutex:
            return self._find(camera, instant) is not None

    def frame(self, camera: str, instant: int) -> FrameRecord | None:
        """Return the record of a saved frame without its residual, or None."""
        with self._mutex:
            if (files := self._find(camera, instant)) is None:
                return None
            part, place = files
            record, start = part.record, part.starts[place]
        with (self._folder / frames_path(record.path)).open("rb") as file:
            file.seek(start)
            return frame_of_line(record, msgspec.json.decode(file.readline(), type=FrameRecord))

    def instants(self, camera: str) -> list[int]:
        """Return the instants for which a camera's video has a frame, in order."""
        with self._mutex:
            return sorted(chain.from_iterable(part.instants for part in self._videos.get(camera, ())))

    def in_order(self, instants: int) -> Iterator[FrameRecord]:
        """Yield all frames of the first instants of a recording without their residuals, by instant."""
        cameras = (self._in_order(parts, instants) for _, parts in sorted(self._videos.items()))
        return heapq.merge(*cameras, key=lambda record: record.instant)

    def append(self, camera: str, frames: Iterable[StoredImage]) -> None:
        """Append frames of one camera, all or none; they are safe after the next `sync`.

        Frames of instants that the video already contains are skipped. Raises DiskError, TryAgainError where
        the session was renamed meanwhile, BadInputError.
        """
        with self._held.writing(), self._writing[camera]:
            parts = self._parts(camera)
            waiting = {instant for part in parts for instant, _, _ in part.unsynced} - {NO_INSTANT}
            new = list[StoredImage]()
            for frame in frames:
                instant = frame.record.instant
                if instant not in waiting and not self.has(camera, instant):
                    waiting |= {instant} - {NO_INSTANT}
                    new.append(frame)
            if parts[-1].end > max(0, MAX_PART_BYTES - sum(len(frame.data) for frame in new)):
                self._begin_part(camera, parts[-1].number + 1)
            try:
                _append(parts[-1], new)
            except OSError as error:
                if error.errno != EFBIG or not parts[-1].end:
                    raise
                # This disk's largest file is smaller.
                self._begin_part(camera, parts[-1].number + 1)
                _append(parts[-1], new)
            self.knows_true_times |= any(frame.true_ns is not None for frame in new)

    def sync(self, camera: str) -> None:
        """Sync what was appended to a camera's video, then its lines.

        Raises as `append`; what was appended since the last sync is then not in the video.
        """
        parts = self._videos.get(camera, [])
        with self._held.writing(), self._writing[camera]:
            try:
                for part in parts:
                    self._sync(part)
            except OSError:
                for part in parts:
                    part.unsynced = []
                    part.truncate()
                raise
            for part in parts[:-1]:
                part.close()

    def records(self) -> tuple[VideoRecord, ...]:
        """Return the manifest's records of the videos, one for each part."""
        with self._mutex:
            return tuple(part.record for _, parts in sorted(self._videos.items()) for part in parts)

    def leave_out(self, cameras: Set[str]) -> None:
        """Set aside the videos of these cameras. Raises OSError."""
        with self._mutex:
            for part in chain.from_iterable(map(self._videos.pop, self._videos.keys() & cameras)):
                part.close()
                for path in (part.record.path, frames_path(part.record.path)):
                    set_aside(self._folder, path)

    def close(self) -> None:
        """Close all files, whose contents are on disk already. May be called twice."""
        with self._mutex:
            for part in chain.from_iterable(self._videos.values()):
                part.close()

    def _find(self, camera: str, instant: int) -> tuple[_Part, int] | None:
        """Return the part of a camera's video that has the frame of an instant, and its index there."""
        for part in self._videos.get(camera, ()):
            if (place := part.find(instant)) is not None:
                return part, place
        return None

    def _in_order(self, parts: list[_Part], instants: int) -> Iterator[FrameRecord]:
        of_parts = [zip(part.instants, repeat(number), part.starts) for number, part in enumerate(parts)]
        of_instants = takewhile(lambda frame: frame[0] < instants, heapq.merge(*of_parts))
        # A late frame may be in a later part.
        for number, frames in groupby(of_instants, key=lambda frame: frame[1]):
            record = parts[number].record
            with (self._folder / frames_path(record.path)).open("rb") as file:
                at = 0
                for _, _, start in frames:
                    if start != at:
                        file.seek(start)
                    line = file.readline()
                    at = start + len(line)
                    yield frame_of_line(record, msgspec.json.decode(line, type=FrameRecord))

    def _sync(self, part: _Part) -> None:
        frames, part.unsynced = part.unsynced, []
        if not frames:
            return
        system.sync_data(part.handle)
        if not os.fstat(part.handle).st_nlink or (
            os.name == "nt" and not (self._folder / part.record.path).exists()
        ):
            # A person has deleted it; no frame of it may count as saved.
            raise FileNotFoundError(ENOENT, os.strerror(ENOENT), part.record.path)
        part.lines.append(*(line for _, line, _ in frames), durable=True)
        with self._mutex:
            for instant, line, frame_end in frames:
                part.note(instant, len(line) + 1, frame_end)

    def _parts(self, camera: str) -> list[_Part]:
        with self._mutex:
            if camera not in self._videos:
                check_name(camera, "camera")
                make_folders((self._folder / video_path(camera)).parent, self._folder)
                self._begin_part(camera, 0)
            return self._videos[camera]

    def _begin_part(self, camera: str, number: int) -> _Part:
        """Open a further part of a camera's video for writing."""
        path = video_path(camera, number)
        lines = AppendOnlyFile(self._folder / frames_path(path))
        handle = system.open_file(self._folder / path, os.O_WRONLY | os.O_CREAT)
        part = _Part(number, handle, lines, VideoRecord(camera=camera, path=path, frames=0, bytes=0))
        self._videos.setdefault(camera, []).append(part)
        sync_folder((self._folder / path).parent)
        return part

    def _recover(self, camera: str, number: int, lines: Path) -> None:
        path = self._folder / video_path(camera, number)
        size = path.stat().st_size if path.exists() else 0
        complete: list[tuple[int, int, int]] = []
        for line, frame in _whole_frames(lines, size):
            complete.append((frame.instant, len(line), frame.offset + frame.bytes))
            self.knows_true_times |= frame.true_ns is not None
        if sum(line_bytes for _, line_bytes, _ in complete) < lines.stat().st_size:
            write_atomic(lines, b"".join(line for line, _ in _whole_frames(lines, size)))
        end = complete[-1][2] if complete else 0
        if size > end:
            self._set_aside_from(path, end)
        for part in self._videos.get(camera, ()):
            part.close()
        part = self._begin_part(camera, number)
        for instant, line_bytes, frame_end in complete:
            part.note(instant, line_bytes, frame_end)

    def _set_aside_from(self, path: Path, end: int) -> None:
        """Move the bytes of a video from offset `end` on to a separate file."""
        aside = self._folder / SET_ASIDE / path.relative_to(self._folder)
        make_folders(aside.parent, self._folder)
        with path.open("rb") as video, free_name(aside).open("wb") as rest:
            video.seek(end)
            shutil.copyfileobj(video, rest)
            rest.flush()
            system.sync_data(rest.fileno())
        sync_folder(aside.parent)
        os.truncate(path, end)


def _append(part: _Part, frames: Iterable[StoredImage]) -> None:
    """Write frames at the end of a part, all or none. Raises OSError."""
    written, end = list[tuple[int, bytes, int]](), part.end
    try:
        os.lseek(part.handle, end, os.SEEK_SET)
        for frame in frames:
            line, end = frame_line(frame.record, end, frame.true_ns), end + len(frame.data)
            write_all(part.handle, frame.data)
            written.append((frame.record.instant, line, end))
    except (OSError, SimulshotError):
        part.truncate()
        raise
    part.unsynced += written


def _whole_frames(lines: Path, size: int) -> Iterator[tuple[bytes, FrameRecord]]:
    """Yield the complete lines, and their frames one after the other, in a video of `size` bytes.

    Of two frames of one instant, the first counts.
    """
    end, instants = 0, set[int]()
    with lines.open("rb") as file:
        for line in file:
            # A line torn by a crash has no newline.
            frame = record_of_line(line, FrameRecord) if line.endswith(b"\n") else None
            if frame is None or frame.instant in instants:
                continue
            if end <= frame.offset and frame.offset + frame.bytes <= size:
                end = frame.offset + frame.bytes
                instants |= {frame.instant} - {NO_INSTANT}
                yield line, frame
