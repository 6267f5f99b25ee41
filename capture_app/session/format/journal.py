"""Lines of a session's journals: for each image that is safely on disk, and each frame safely in a video."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import PurePosixPath
from typing import TypeVar

import msgspec
from msgspec import Struct

from capture_app.camera_facts import Count, Positive
from capture_app.session.format.manifest import RIG, VIDEOS, FrameRecord, ImageRecord, Sha256, VideoRecord
from capture_app.text import UNREADABLE

_T = TypeVar("_T")


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


FRAMES_SUFFIX = ".frames.ndjson"


class VideoFrame(Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """One frame of a video; its fields are those of `ImageRecord`."""

    offset: Count
    """Where its first byte is in the video."""
    bytes: Positive
    sha256: Sha256
    leader_ns: int
    instant: Count | None = None
    """None for a frame that belongs to no instant of the recording."""
    local_ns: int | None = None
    uncertainty_ns: Count | None = None
    hard_bound_ns: Count | None = None
    exposure_start_ns: int | None = None
    exposure_ns: Count | None = None
    gain: float | None = None
    white_balance: tuple[float, float] | None = None
    sequence: Count | None = None
    outlier_ns: int = 0
    alignment_offset_ns: int = 0
    late: bool = False
    true_ns: int | None = None
    """True start of the first row's exposure, of a simulated frame, in the host's clock."""


_SHARED = tuple({*VideoFrame.__struct_fields__} & {*ImageRecord.__struct_fields__} - {"instant"})


def frames_path(video: str) -> str:
    """Path of the frames' lines of a video, beside it."""
    return str(PurePosixPath(video).with_suffix(FRAMES_SUFFIX))


def is_frames_path(path: str) -> bool:
    """Whether a path inside a session is that of frames' lines."""
    return path.startswith(f"{VIDEOS}/{RIG}/") and path.endswith(FRAMES_SUFFIX)


def frame_line(record: ImageRecord, offset: int, true_ns: int | None = None) -> bytes:
    """The line of an image that lies in its video at `offset`."""
    shared = {name: getattr(record, name) for name in _SHARED}
    return msgspec.json.encode(VideoFrame(offset=offset, instant=record.instant, true_ns=true_ns, **shared))


def frame_record(video: VideoRecord, frame: VideoFrame, instant: int, instant_ns: int) -> FrameRecord:
    """A frame of an instant as an image of its session."""
    shared = {name: getattr(frame, name) for name in _SHARED}
    return FrameRecord(
        camera=video.camera,
        instant=instant,
        path=video.path,
        offset=frame.offset,
        residual_ns=frame.leader_ns - instant_ns,
        **shared,
    )


def frame_records(
    video: VideoRecord, frames: Iterable[VideoFrame], instants_ns: Sequence[int]
) -> Iterator[FrameRecord]:
    """Yield the frames that belong to instants of a recording, as images of it."""
    for frame in frames:
        if frame.instant is not None and frame.instant < len(instants_ns):
            yield frame_record(video, frame, frame.instant, instants_ns[frame.instant])
