"""Journals of a session, with a line for each image, frame or true time on disk, and the ground truth."""

from pathlib import PurePosixPath
from typing import TypeVar

import msgspec
from msgspec import Struct, structs

from capture_app.common.clock import SimulatedClock
from capture_app.common.text import UNREADABLE
from capture_app.session.files.untrusted_files import encode_checked
from capture_app.session.format.manifest import (
    GROUND_TRUTH,
    RIG,
    VIDEOS,
    FrameRecord,
    ImageRecord,
    Sha256,
    VideoRecord,
)

_T = TypeVar("_T")
FRAMES_SUFFIX = ".frames.ndjson"
TIMES = f"{GROUND_TRUTH}/times.json"
TRUE_TIMES_JOURNAL = f"{GROUND_TRUTH}/times.ndjson"
"""The true times, a line each as they come, of a burst that a crash may interrupt."""


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
    """Encode the line of a frame that begins at byte `offset` of its video.

    Raises BadInputError if no session can contain it.
    """
    fields = structs.asdict(record) | {"camera": "", "path": "", "residual_ns": 0}
    what = f"image {record.instant} of camera {record.camera}"
    return encode_checked(FrameRecord(offset=offset, true_ns=true_ns, **fields), what)


def frame_of_line(video: VideoRecord, line: FrameRecord, due_ns: int | None = None) -> FrameRecord:
    """Complete a decoded frame line with its camera, its video's path, and its residual if it was due then.

    `due_ns` is the time of its instant, with its camera's planned delay.
    """
    residual_ns = 0 if due_ns is None else line.leader_ns - due_ns
    return structs.replace(line, camera=video.camera, path=video.path, residual_ns=residual_ns)


class TrueTime(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """True start of the first row's exposure of one image, in ns of the host's clock."""

    camera: str
    instant: int
    true_ns: int
    sha256: Sha256 | None = None
    """Checksum of the image's .npz; None where it has none."""


class TrueTimes(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """True times of the images, and the true clock of each camera by name."""

    images: tuple[TrueTime, ...] = ()
    clocks: dict[str, SimulatedClock] = {}


def ground_truth_path(camera: str, instant: int) -> str:
    """Return the path of an image's ground truth, relative to its session."""
    return f"{GROUND_TRUTH}/{camera}/{instant:06d}.npz"
