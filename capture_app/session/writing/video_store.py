"""Videos of a session being written: frames are appended, and count once they and their lines are synced."""

import heapq
import os
import shutil
import threading
from array import array
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Set
from contextlib import suppress
from dataclasses import dataclass, field
from errno import ENOENT
from pathlib import Path

import msgspec

from capture_app.common import system
from capture_app.common.names import check_name
from capture_app.session.files.disk import disk_errors
from capture_app.session.files.durable import (
    AppendOnlyFile,
    free_name,
    make_folders,
    sync_folder,
    write_all,
    write_atomic,
)
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
    video_path,
)
from capture_app.session.writing.image_store import StoredImage
from capture_app.session.writing.recovery import SET_ASIDE, set_aside


@dataclass(slots=True)
class _Video:
    """One camera's video; memory holds only the offset of each frame's line."""

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
    writing: threading.Lock = field(default_factory=threading.Lock)
    """Held while the files are written or synced."""

    @property
    def end(self) -> int:
        """End of the last appended frame."""
        return self.unsynced[-1][2] if self.unsynced else self.record.bytes

    def find(self, instant: int) -> int | None:
        """Return the index of an instant's frame, or None."""
        place = bisect_left(self.instants, instant)
        return place if place < len(self.instants) and self.instants[place] == instant else None

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

    def __init__(self, folder: Path) -> None:
        """Adopt the videos that an interrupted writer left.

        A torn line is dropped, and bytes after the last frame with a line are set aside.
        """
        self._folder = folder
        self._videos: dict[str, _Video] = {}
        self._mutex = threading.Lock()
        self.knows_true_times = False
        """Whether any frame came with its true time."""
        for lines in sorted((self._folder / VIDEOS).glob(f"*/*{FRAMES_SUFFIX}")):
            self._recover(lines.name.removesuffix(FRAMES_SUFFIX), lines)

    def has(self, camera: str, instant: int) -> bool:
        """Return whether a camera's video has the frame of an instant."""
        with self._mutex:
            video = self._videos.get(camera)
            return video is not None and video.find(instant) is not None

    def frame(self, camera: str, instant: int) -> FrameRecord | None:
        """Return the record of a saved frame without its residual, or None."""
        with self._mutex:
            video = self._videos.get(camera)
            if video is None or (place := video.find(instant)) is None:
                return None
            record, start = video.record, video.starts[place]
        with (self._folder / frames_path(record.path)).open("rb") as file:
            file.seek(start)
            return frame_of_line(record, msgspec.json.decode(file.readline(), type=FrameRecord))

    def instants(self, camera: str) -> "array[int]":
        """Return the instants for which a camera's video has a frame, in order."""
        with self._mutex:
            video = self._videos.get(camera)
            return array("Q") if video is None else video.instants[:]

    def in_order(self, instants: int) -> Iterator[FrameRecord]:
        """Yield all frames of the first instants of a recording without their residuals, by instant."""
        cameras = (self._in_order(video, instants) for _, video in sorted(self._videos.items()))
        return heapq.merge(*cameras, key=lambda record: record.instant)

    def append(self, camera: str, frames: Iterable[StoredImage]) -> None:
        """Append frames of one camera, all or none; they are safe after the next `sync`.

        Frames of instants that the video already contains are skipped. Raises DiskError, BadInputError.
        """
        with disk_errors(self._folder):
            with self._mutex:
                video = self._video(camera)
            with video.writing:
                self._append(video, frames)

    def sync(self, camera: str) -> None:
        """Sync what was appended to a camera's video, then its lines.

        Raises DiskError; what was appended since the last sync is then not in the video.
        """
        if (video := self._videos.get(camera)) is None:
            return
        with video.writing, disk_errors(self._folder):
            frames, video.unsynced = video.unsynced, []
            try:
                if frames:
                    system.sync_data(video.handle)
                    if not os.fstat(video.handle).st_nlink or (
                        os.name == "nt" and not (self._folder / video.record.path).exists()
                    ):
                        # A person has deleted it; no frame of it may count as saved.
                        raise FileNotFoundError(ENOENT, os.strerror(ENOENT), video.record.path)
                    video.lines.append(*(line for _, line, _ in frames), durable=True)
            except OSError:
                self._truncate(video)
                raise
            with self._mutex:
                for instant, line, frame_end in frames:
                    video.note(instant, len(line) + 1, frame_end)

    def records(self) -> tuple[VideoRecord, ...]:
        """Return the manifest's records of the videos."""
        with self._mutex:
            return tuple(self._videos[camera].record for camera in sorted(self._videos))

    def leave_out(self, cameras: Set[str]) -> None:
        """Set aside the videos of these cameras. Raises OSError."""
        with self._mutex:
            for camera in self._videos.keys() & cameras:
                video = self._videos.pop(camera)
                video.close()
                for path in (video.record.path, frames_path(video.record.path)):
                    set_aside(self._folder, path)

    def close(self) -> None:
        """Close all files, whose contents are on disk already. May be called twice."""
        with self._mutex:
            for video in self._videos.values():
                video.close()

    def _in_order(self, video: _Video, instants: int) -> Iterator[FrameRecord]:
        with (self._folder / frames_path(video.record.path)).open("rb") as file:
            at = 0
            for instant, start in zip(video.instants, video.starts, strict=True):
                if instant >= instants:
                    return
                if start != at:
                    file.seek(start)
                line = file.readline()
                at = start + len(line)
                yield frame_of_line(video.record, msgspec.json.decode(line, type=FrameRecord))

    def _append(self, video: _Video, given: Iterable[StoredImage]) -> None:
        end, frames = video.end, []
        waiting = {instant for instant, _, _ in video.unsynced if instant != NO_INSTANT}
        for frame in given:
            instant = frame.record.instant
            if video.find(instant) is None and instant not in waiting:
                waiting |= {instant} - {NO_INSTANT}
                line, end = frame_line(frame.record, end, frame.true_ns), end + len(frame.data)
                frames.append((frame, line, end))
        try:
            os.lseek(video.handle, video.end, os.SEEK_SET)
            for frame, _, _ in frames:
                write_all(video.handle, frame.data)
        except OSError:
            self._truncate(video)
            raise
        for frame, line, frame_end in frames:
            video.unsynced.append((frame.record.instant, line, frame_end))
            self.knows_true_times |= frame.true_ns is not None

    def _truncate(self, video: _Video) -> None:
        """Remove what was written after the last appended frame."""
        with suppress(OSError):
            os.ftruncate(video.handle, video.end)

    def _video(self, camera: str) -> _Video:
        if camera not in self._videos:
            check_name(camera, "camera")
            folder = (self._folder / video_path(camera)).parent
            make_folders(folder, self._folder)
            self._videos[camera] = self._open(camera)
            sync_folder(folder)
        return self._videos[camera]

    def _open(self, camera: str) -> _Video:
        path = video_path(camera)
        lines = AppendOnlyFile(self._folder / frames_path(path))
        handle = system.open_file(self._folder / path, os.O_WRONLY | os.O_CREAT)
        return _Video(handle, lines, VideoRecord(camera=camera, path=path, frames=0, bytes=0))

    def _recover(self, camera: str, lines: Path) -> None:
        path = self._folder / video_path(camera)
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
        video = self._videos[camera] = self._open(camera)
        for instant, line_bytes, frame_end in complete:
            video.note(instant, line_bytes, frame_end)

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
