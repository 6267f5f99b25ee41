"""Lines of a session's journals: for each image that is safely on disk, and each frame safely in a video."""

from pathlib import PurePosixPath
from typing import TypeVar

import msgspec
from msgspec import structs

from capture_app.common.text import UNREADABLE
from capture_app.session.format.manifest import RIG, VIDEOS, FrameRecord, ImageRecord, VideoRecord

_T = TypeVar("_T")
FRAMES_SUFFIX = ".frames.ndjson"


def record_of_line(line: bytes, kind: type[_T]) -> _T | None:
    """Read a line; None for one that a crash has torn or a fault has changed."""
    try:
        return msgspec.json.decode(line, type=kind)
    except UNREADABLE:
        return None


def lines_of_file(data: bytes) -> list[bytes]:
    """The lines of a journal file; what follows the last newline is a torn one."""
    lines = data.split(b"\n")
    return lines if lines[-1] else lines[:-1]


def frames_path(video: str) -> str:
    """Path of the frames' lines of a video, beside it."""
    return str(PurePosixPath(video).with_suffix(FRAMES_SUFFIX))


def is_frames_path(path: str) -> bool:
    """Whether a path inside a session is a video's file of frame lines."""
    return path.startswith(f"{VIDEOS}/{RIG}/") and path.endswith(FRAMES_SUFFIX)


def frame_line(record: ImageRecord, offset: int, true_ns: int | None = None) -> bytes:
    """The line of an image that its video holds at `offset`."""
    fields = structs.asdict(record) | {"camera": "", "path": "", "residual_ns": 0}
    return msgspec.json.encode(FrameRecord(offset=offset, true_ns=true_ns, **fields))


def frame_of_line(video: VideoRecord, line: FrameRecord, instant_ns: int) -> FrameRecord:
    """A frame with what its line leaves out: its camera, its video and its distance from its instant."""
    residual_ns = line.leader_ns - instant_ns
    return structs.replace(line, camera=video.camera, path=video.path, residual_ns=residual_ns)
