"""Lines of a session's journals: one for each image, or frame of a video, that is safely on disk."""

from pathlib import PurePosixPath
from typing import TypeVar

import msgspec
from msgspec import structs

from capture_app.common.text import UNREADABLE
from capture_app.session.format.manifest import RIG, VIDEOS, FrameRecord, ImageRecord, VideoRecord

_T = TypeVar("_T")
FRAMES_SUFFIX = ".frames.ndjson"


def record_of_line(line: bytes, kind: type[_T]) -> _T | None:
    """Decode a journal line as `kind`; return None if a crash or a disk fault has damaged it."""
    try:
        return msgspec.json.decode(line, type=kind)
    except UNREADABLE:
        return None


def lines_of_file(data: bytes) -> list[bytes]:
    """Split a journal file into lines; text after the last newline is returned as a torn line."""
    lines = data.split(b"\n")
    return lines if lines[-1] else lines[:-1]


def frames_path(video: str) -> str:
    """Return the path of the file beside a video that has a line for each of its frames."""
    return str(PurePosixPath(video).with_suffix(FRAMES_SUFFIX))


def is_frames_path(path: str) -> bool:
    """Return whether a path inside a session is such a file; see `frames_path`."""
    return path.startswith(f"{VIDEOS}/{RIG}/") and path.endswith(FRAMES_SUFFIX)


def frame_line(record: ImageRecord, offset: int, true_ns: int | None = None) -> bytes:
    """Encode the line of a frame that begins at byte `offset` of its video."""
    fields = structs.asdict(record) | {"camera": "", "path": "", "residual_ns": 0}
    return msgspec.json.encode(FrameRecord(offset=offset, true_ns=true_ns, **fields))


def frame_of_line(video: VideoRecord, line: FrameRecord, instant_ns: int) -> FrameRecord:
    """Complete a decoded frame line with its camera, its video's path and its time from its instant."""
    residual_ns = line.leader_ns - instant_ns
    return structs.replace(line, camera=video.camera, path=video.path, residual_ns=residual_ns)
