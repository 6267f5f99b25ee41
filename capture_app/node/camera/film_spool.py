"""A burst's images in its node's spool: a film of segments, each deleted when the leader has all of it.

SPOOL/<camera>/<leader>-<burst>/
  <number>.film     images with a simulated camera's ground truth, one after the other
  <number>.ndjson   a line per image: its place in the film, and the header that it is sent with
"""

import os
import stat
import threading
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import msgspec
from msgspec import Struct

from capture_app.common import system
from capture_app.common.bounds import Count
from capture_app.protocol.messages import ImageUpload
from capture_app.session.files.disk import disk_error, disk_errors
from capture_app.session.files.durable import AppendOnlyFile, write_all, write_atomic
from capture_app.session.files.untrusted_files import read_regular
from capture_app.session.format.journal import record_of_line
from capture_app.session.format.manifest import JOURNAL

_Line = TypeVar("_Line", bound=Struct)
FILM, INDEX = ".film", ".ndjson"
SEGMENT_BYTES = 8 << 20
"""Length of a segment; most are deleted before the system has written them to the disk."""


class IndexLine(Struct, frozen=True, kw_only=True):
    """Place of a frame in its segment, and its header."""

    offset: Count
    frame: ImageUpload


class FileLine(ImageUpload, frozen=True, kw_only=True, tag="image"):
    """Line of protocol 7's journal, about an image that is a file of its own."""

    offset: Count = 0

    @property
    def header(self) -> ImageUpload:
        """The header that the image is sent with today."""
        return ImageUpload(**{field: getattr(self, field) for field in ImageUpload.__struct_fields__})


class Segment:
    """Files of one segment, and how many of its frames the leader does not have."""

    def __init__(self, path: Path, *, has_index: bool = True) -> None:
        """A file of protocol 7, which has one image, has no index of its own."""
        self.path, self.index = path, path.with_suffix(INDEX)
        self.files = (self.path, self.index) if has_index else (self.path,)
        self.waiting = self.length = 0


class SpooledFilm:
    """Film of one burst on a node. Threads may share it; methods block on the disk, but for `release`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._places: dict[int, tuple[Segment, int]] = {}
        """Segment and offset of each frame that the leader does not have, by instant."""
        self._current: Segment | None = None
        self._number = 0
        """Number of the last segment; 0 while unknown."""
        self._handle = -1
        self._lines: AppendOnlyFile | None = None
        self._unsynced: set[Segment] = set()
        self._changing = threading.Lock()
        self.unreadable: dict[Path, bytes | None] = {}
        """Indexes of an earlier run with whole lines that are not understood, and these; None for all."""

    def recover(self) -> Iterator[ImageUpload]:
        """Yield the headers of the frames that an earlier run has left, also as files. Raises DiskError."""
        with disk_errors(self._folder):
            for path in sorted(self._folder.glob(f"*{FILM}")):
                segment = Segment(path)
                for place in self._records_of(segment.index, IndexLine):
                    if place.offset + place.frame.bytes <= _size_of(path):
                        yield self._note_left(place.frame, segment, place.offset)
            for image in self._records_of(self._folder / JOURNAL, FileLine):
                path = self._folder / f"{image.record.instant:06d}.jpg"
                if _size_of(path) >= image.bytes:
                    yield self._note_left(image.header, Segment(path, has_index=False), 0)

    def _records_of(self, index: Path, kind: type[_Line]) -> list[_Line]:
        """Return the whole lines of an index that are understood: what a power cut has torn has no end."""
        try:
            *lines, torn = read_regular(index, follow_links=False).split(b"\n")
        except FileNotFoundError:
            return []
        except OSError:
            # A link or a pipe, which a node did not write.
            lines, torn = [b""], b""
        records = [record_of_line(line, kind) for line in lines]
        if None in records:
            left = [line for line, record in zip(lines, records, strict=True) if record is None]
            self.unreadable[index] = b"\n".join((*left, torn)) if len(left) < len(lines) else None
        return [record for record in records if record is not None]

    def _note_left(self, frame: ImageUpload, segment: Segment, offset: int) -> ImageUpload:
        self._places[frame.record.instant] = segment, offset
        segment.waiting += 1
        self._unsynced.add(segment)
        return frame

    def forget_readable(self) -> None:
        """Keep the lines alone that are not understood: frames that the leader has are not offered again.

        Raises OSError.
        """
        for index, left in self.unreadable.items():
            if left is not None:
                write_atomic(index, left)

    def keeps(self, path: Path) -> bool:
        """Return whether a file belongs to what is not understood."""
        is_image = path.suffix == ".jpg" and self._folder / JOURNAL in self.unreadable
        return is_image or path.with_suffix(INDEX) in self.unreadable

    def append(self, frames: Iterable[tuple[ImageUpload, bytes]]) -> None:
        """Append frames, all or none: they survive this process now, and a power cut after `sync`.

        Raises DiskFullError, SimulshotError.
        """
        with self._changing:
            try:
                segment, lines = self._open()
                end, index = segment.length, []
                for frame, data in frames:
                    write_all(self._handle, data)
                    index.append(
                        (frame.record.instant, end, msgspec.json.encode(IndexLine(offset=end, frame=frame)))
                    )
                    end += len(data)
                lines.append(*(line for _, _, line in index), durable=False)
            except OSError as error:
                with suppress(OSError):
                    if self._current is not None:
                        os.ftruncate(self._handle, self._current.length)
                self._close()
                raise disk_error(error, self._folder) from error
            segment.length, segment.waiting = end, segment.waiting + len(index)
            self._places |= {instant: (segment, offset) for instant, offset, _ in index}
            self._unsynced.add(segment)

    def read(self, frames: Sequence[ImageUpload]) -> list[bytes | None]:
        """Return the bytes of each frame; None if the film does not have all of them. Raises DiskError."""
        images: list[bytes | None] = []
        handles: dict[Segment, int] = {}
        try:
            with disk_errors(self._folder):
                for frame in frames:
                    if (place := self._places.get(frame.record.instant)) is None:
                        images.append(None)
                        continue
                    segment, offset = place
                    try:
                        if segment not in handles:
                            handles[segment] = system.open_file(segment.path, os.O_RDONLY, follow_links=False)
                        data = system.read_at(handles[segment], frame.bytes, offset)
                    except FileNotFoundError:
                        data = b""
                    images.append(data if len(data) == frame.bytes else None)
        finally:
            for handle in handles.values():
                os.close(handle)
        return images

    def release(self, instants: Collection[int]) -> list[Path]:
        """Forget frames that the leader has; return the files that nothing needs any more."""
        with self._changing:
            touched = set()
            for instant in instants:
                if (place := self._places.pop(instant, None)) is not None:
                    place[0].waiting -= 1
                    touched.add(place[0])
            done = {
                segment
                for segment in touched
                if not segment.waiting and segment is not self._current and not self.keeps(segment.index)
            }
            self._unsynced -= done
            return [path for segment in done for path in segment.files]

    def to_sync(self) -> list[Path]:
        """Return the files to sync, so that what was appended since the last call survives a power cut."""
        with self._changing:
            unsynced, self._unsynced = self._unsynced, set()
            return [path for segment in unsynced for path in segment.files]

    def close(self) -> None:
        """Close the files; frames that are appended later go into a new segment."""
        with self._changing:
            self._close()

    def _open(self) -> tuple[Segment, AppendOnlyFile]:
        """Return the current segment, a new one after SEGMENT_BYTES. Raises OSError."""
        if self._current is None or self._lines is None or self._current.length >= SEGMENT_BYTES:
            self._close()
            if not self._number:
                # A power cut may have left an index without its film.
                left = (path.stem for kind in (FILM, INDEX) for path in self._folder.glob(f"*{kind}"))
                self._number = max((int(stem) for stem in left if stem.isdecimal()), default=0)
            self._number += 1
            segment = Segment(self._folder / f"{self._number:06d}{FILM}")
            self._handle = system.open_file(segment.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
            self._current, self._lines = segment, AppendOnlyFile(segment.index)
        return self._current, self._lines

    def _close(self) -> None:
        if self._handle >= 0:
            os.close(self._handle)
        if self._lines is not None:
            self._lines.close()
        if self._current is not None and not self._current.waiting:
            # No later frame is released from it, as the leader had all of them before the next one came.
            self._unsynced.discard(self._current)
            with suppress(OSError):
                for path in self._current.files:
                    path.unlink()
        self._current, self._handle, self._lines = None, -1, None


def _size_of(path: Path) -> int:
    """Return the size of a regular file in bytes; -1 if there is none, as behind a link."""
    try:
        status = path.lstat()
    except OSError:
        return -1
    return status.st_size if stat.S_ISREG(status.st_mode) else -1
