"""Session reader; sessions are untrusted input, so the manifest is checked before it is used."""

import os
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

import msgspec

from capture_app.common import system
from capture_app.common.errors import BadInputError, IncompleteError
from capture_app.common.names import FOOTAGE, is_name
from capture_app.common.text import UNREADABLE
from capture_app.session.files.locks import lock_handle
from capture_app.session.files.untrusted_files import (
    read_arrays,
    read_input,
    read_regular,
    read_struct,
    rejecting,
)
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.journal import (
    TIMES,
    TrueTime,
    TrueTimes,
    frame_of_line,
    frames_path,
    ground_truth_path,
)
from capture_app.session.format.manifest import (
    CALIBRATION,
    JOURNAL,
    MANIFEST,
    NO_INSTANT,
    CameraRecord,
    FrameRecord,
    ImageRecord,
    Manifest,
    PathCheck,
    VideoRecord,
    inside,
)
from capture_app.session.format.stored_manifest import read_manifest

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

INCOMING = "incoming"
"""Folder that marks a finished session as reopened, until its manifest is written again."""
WritingState = Literal["being written", "interrupted", "finished", "reopened", "interrupted again"]
"""State of a session's writing; all but the first two have a manifest.

A reopened session receives late images: files appear, and the journal and the lines of videos grow. Its
manifest describes what was finished, until it is replaced.
"""


class Session:
    """A complete session: its manifest and its files. Created by `Session.open`."""

    def __init__(self, folder: Path, manifest: Manifest) -> None:
        """Take a checked `manifest`, as stored on disk."""
        self.folder = folder
        self.stored_manifest = manifest
        self._check = PathCheck(folder)
        self._cameras = {camera.name: camera for camera in manifest.cameras}

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a session's folder.

        Raises BadInputError if it is not a session or its manifest is invalid, and IncompleteError if the
        capture never finished or is still running.
        """
        folder = Path(path)
        if not folder.is_dir():
            raise no_session(folder)
        if not (folder / MANIFEST).is_file():
            raise _without_manifest(folder)
        manifest = read_manifest(folder / MANIFEST)
        session = cls(folder, manifest)
        for record in chain[ImageRecord | VideoRecord](manifest.images, manifest.videos):
            session._check(record.path)
        return session

    @cached_property
    def manifest(self) -> Manifest:
        """The manifest, with the frames of videos as images. Raises BadInputError if they are malformed."""
        stored, instants_ns = self.stored_manifest, self.stored_manifest.burst.instants_ns
        frames = (
            camera.widen(frame_of_line(video, frame, instants_ns[frame.instant] + camera.delay_ns))
            for video in stored.videos
            for camera in (self.camera(video.camera),)
            for frame in self.video_frames(video)
            if 0 <= frame.instant < len(instants_ns)
        )
        in_order = sorted(frames, key=lambda record: (record.instant, record.camera))
        return msgspec.structs.replace(stored, images=(*stored.images, *in_order)) if in_order else stored

    @property
    def name(self) -> str:
        """Name given to the session when it was captured; its folder may have been renamed since."""
        return self.stored_manifest.name

    @property
    def is_arriving(self) -> bool:
        """Whether a leader has the session open because its missing images arrive at last."""
        return writing_state(self.folder) == "reopened"

    def camera(self, name: str) -> CameraRecord:
        """Return the record of a camera. Raises BadInputError if the session has no such camera."""
        if name not in self._cameras:
            raise BadInputError(
                f"{self.folder} has no camera {name!r}",
                hint="it has "
                + ", ".join(
                    own if own == label else f"{own} ({label})"
                    for own, label in self.stored_manifest.labels.items()
                ),
            )
        return self._cameras[name]

    def image_file(self, record: ImageRecord) -> Path:
        """Return the file that contains an image, which is the video for a frame of one; see `image_bytes`.

        Raises BadInputError if its path is outside the session.
        """
        self._check(record.path)
        return self.folder / record.path

    def image_place(self, record: ImageRecord) -> tuple[Path, int]:
        """Return the file that contains an image, and its byte offset there. Raises as `image_file` does."""
        return self.image_file(record), record.offset if isinstance(record, FrameRecord) else 0

    def image_bytes(self, record: ImageRecord) -> bytes:
        """Return an image's bytes, as in an image file. Raises OSError, BadInputError as `image_file`."""
        path, offset = self.image_place(record)
        if not isinstance(record, FrameRecord):
            return read_regular(path)
        with path.open("rb") as video:
            video.seek(offset)
            return video.read(record.bytes)

    def video_frames(self, video: VideoRecord, *, further: bool = False) -> list[FrameRecord]:
        """Return the records of a video's frames, in order. Raises BadInputError for a malformed file.

        Frames that have arrived since the manifest was written are left out, unless `further`.
        """
        path = inside(self.folder, frames_path(video.path))
        with rejecting(
            f"{path} does not hold the frames of a video",
            *UNREADABLE,
            hint=f"capture-app sessions verify {self.folder} shows all problems",
        ):
            lines = read_input(path).split(b"\n", -1 if further else video.frames)
            return msgspec.json.Decoder(FrameRecord).decode_lines(
                b"\n".join(lines if further else lines[: video.frames])
            )

    def images_by_instant(self) -> list[dict[str, ImageRecord]]:
        """Return the images of each instant in order, by camera name; a missing image has no entry."""
        instants: list[dict[str, ImageRecord]] = [{} for _ in self.manifest.burst.instants_ns]
        for record in self.manifest.images:
            instants[record.instant][record.camera] = record
        return instants

    def calibration(self) -> Calibration | None:
        """Return the rig's calibration, or None. Raises BadInputError if the file is malformed."""
        path = self.folder / CALIBRATION
        return read_struct(path, Calibration, 1) if path.exists() else None

    def ground_truth(self, camera: str, instant: int) -> Path | None:
        """Return the .npz with an image's true depth and masks, or None."""
        path = self.folder / ground_truth_path(camera, instant)
        # A file may name an instant that is too long for a path.
        return path if is_name(camera) and os.path.isfile(path) else None  # noqa: PTH113

    def read_ground_truth(
        self, camera: str, instant: int
    ) -> "tuple[NDArray[np.float32], NDArray[np.bool_]] | None":
        """Return true depth (m, 0 = unknown) and moving regions of a simulated image, or None.

        Raises BadInputError if the file is malformed.
        """
        if (path := self.ground_truth(camera, instant)) is None:
            return None
        import numpy as np  # slow to import, and every command imports this module

        with rejecting(
            f"{path} is not a ground-truth file",
            ValueError,
            KeyError,
            hint="restore it from a copy, or delete it: only evaluations need it",
        ):
            data = read_arrays(path)
            depth, movers = np.asarray(data["depth_m"], np.float32), np.asarray(data["movers"], np.uint8)
        return np.where(np.isfinite(depth), depth, np.float32(0)), movers > 0

    def true_times(self) -> TrueTimes | None:
        """Return the true times of a simulated session, or None. Raises BadInputError if malformed."""
        path = self.folder / TIMES
        times = read_struct(path, TrueTimes) if path.exists() else TrueTimes()
        frames = [
            TrueTime(camera=video.camera, instant=frame.instant, true_ns=frame.true_ns)
            for video in self.stored_manifest.videos
            for frame in self.video_frames(video)
            if frame.instant != NO_INSTANT and frame.true_ns is not None
        ]
        known = frames or path.exists()
        return msgspec.structs.replace(times, images=(*times.images, *frames)) if known else None


def is_being_written(folder: Path) -> bool:
    """Return whether a writer currently holds the session's lock."""
    handle = system.open_folder(folder)
    try:
        lock_handle(handle, shared=True)
    except BlockingIOError:
        return True
    finally:
        os.close(handle)
    return False


def writing_state(folder: Path) -> WritingState:
    """Return the state of the writing of the session in a folder. Raises OSError."""
    # In the order in which a writer makes them: it may be doing so.
    is_marked, has_manifest = (folder / INCOMING).is_dir(), (folder / MANIFEST).is_file()
    if has_manifest and not is_marked:
        return "finished"
    if is_being_written(folder):
        return "reopened" if has_manifest else "being written"
    return "interrupted again" if has_manifest else "interrupted"


def no_session(path: Path) -> BadInputError:
    """Return the error of a path without a session, with what was probably meant by a bare name."""
    return BadInputError(f"no session at {path}", hint=_instead_of(path))


def _instead_of(path: Path) -> str:
    """Return what was probably meant by a path without a session: one of this name, or footage."""
    inside = Path("sessions", path.name)
    if inside.is_dir() and inside.absolute() != path.absolute():
        return f"it is {inside}"
    if path.name in ("last", "latest", "newest"):
        there = [one.parent for one in Path("sessions").glob(f"*/{MANIFEST}")]
        return (
            f"the newest is {max(there, key=lambda one: one.stat().st_mtime)}" if there else "take one first"
        )
    if path.suffix.casefold() in FOOTAGE:
        return f"footage is imported first: capture-app sessions import {path}"
    if path.exists():
        return f"it has no {MANIFEST}; footage is imported first: capture-app sessions import {path}"
    return "capture-app sessions list shows what is there"


def _without_manifest(folder: Path) -> BadInputError | IncompleteError:
    if not (folder / JOURNAL).is_file():
        return BadInputError(f"{folder} is not a session", hint=_instead_of(folder))
    if writing_state(folder) == "being written":
        return IncompleteError(f"{folder} is still being written", hint="wait until the burst is saved")
    return IncompleteError(
        f"{folder} is incomplete: its capture ended before {MANIFEST} was written",
        hint=f"its images are safe; finish it with: capture-app sessions repair {folder}",
    )
