"""The manifest of a session, `session.json`: one burst of one rig, with the error bar of every image.

This module also computes a manifest's sync record, and checks the rules that every manifest must satisfy.
"""

from __future__ import annotations

import inspect
import os
import stat
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path, PurePosixPath
from typing import Annotated, TypeVar

import msgspec
from msgspec import UNSET, Meta, Struct, UnsetType

from capture_app.common.bounds import Count, FilePath, Positive, Ppm, Real, Sentence, TimeNs
from capture_app.common.camera_facts import CameraFacts, Control, unshared_uncertainties_ns
from capture_app.common.errors import BadInputError
from capture_app.common.names import IMAGE_SUFFIXES, Label, Name, titles_of
from capture_app.common.stagger import describe_steps
from capture_app.common.text import pretty_json
from capture_app.session.files.untrusted_files import RESTORE
from capture_app.session.format.common_times import CommonTimes

SCHEMA_VERSION = 1
MANIFEST = "session.json"
JOURNAL = "journal.ndjson"
EVENTS = "events.ndjson"
CALIBRATION = "calibration.json"
GROUND_TRUTH = "ground_truth"
RECIPE = "recipe.json"
IMAGES = "images"
VIDEOS = "videos"
RIG = "rig1"
NO_INSTANT = -1
"""Instant number of a frame that belongs to no instant of the recording."""

T = TypeVar("T", bound="ImageRecord")
Sha256 = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}$")]


class ClockRecord(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A camera's clock relative to the leader's when the burst was taken; see `leader_from_local`."""

    epoch_local_ns: TimeNs
    offset_ns: TimeNs
    skew_ppm: Ppm
    uncertainty_ns: Count
    hard_bound_ns: Count
    round_trip_ns: Count
    samples: Count
    device_uncertainty_ns: Count | None = None
    """95 % error of the camera's own clock, such as a phone's, against the clock of its node."""
    device_hard_bound_ns: Count | None = None
    """Hard bound of that error."""

    def leader_from_local(self, local_ns: int) -> int:
        """Convert a time of the camera's clock to leader time; both in ns."""
        return local_ns + self.offset_ns + round(self.skew_ppm * 1e-6 * (local_ns - self.epoch_local_ns))


class PhaseRecord(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Phase of a camera's stream on the rig's grid of instants, and how often it was corrected."""

    residual_ns: TimeNs
    period_ns: Positive
    drift_ppm: Ppm
    corrections: Count
    uncertainty_ns: Count | None = None
    tolerance_ns: Count | None = None
    """Largest phase error that is left uncorrected; an image further from its instant is `late`."""


class WidenedTimes(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An interval of a camera's clock whose times were found afterwards to be less accurate, and why."""

    from_local_ns: TimeNs
    until_local_ns: TimeNs
    uncertainty_ns: Count
    """95 % error of the times in the interval."""
    hard_bound_ns: Count
    reason: Sentence


MAX_WIDENED = 64
"""Maximum number of such intervals of a camera in one burst."""


class PhaseMove(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A move of a camera's stream within a recording, which takes back its drift."""

    local_ns: TimeNs
    """Timestamp of the first frame after the move; one to three frames before it lasted longer."""
    shift_ns: TimeNs
    """Delay of all frames from then on."""


MAX_MOVES = 1000
"""Maximum number of a camera's moves that one recording lists; later ones are made all the same."""


class CameraRecord(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """One camera of the rig: its properties, and the state of its clock and phase during the burst."""

    name: Name
    """Name of its folders."""
    facts: CameraFacts
    clock: ClockRecord | None = None
    phase: PhaseRecord | None = None
    held: dict[Control, Real] | UnsetType = UNSET
    """Controls that a user had set, each in its unit; the camera chose the others."""
    delay_ns: Count = 0
    """Planned time of its images after their instants; not 0 for a camera of a staggered rig."""
    widened: Annotated[tuple[WidenedTimes, ...], Meta(max_length=MAX_WIDENED)] = ()
    """Intervals in which a clock was wrong before that was noticed; its images' errors include them."""
    moves: Annotated[tuple[PhaseMove, ...], Meta(max_length=MAX_MOVES)] = ()
    """Moves of its stream within a recording."""
    source_frames: Count | None = None
    """Number of frames in the film or folder from which it was imported; images number them from 0."""
    label: Label = ""
    """Its facts' label, where sessions of November 2026 have it; empty once it is read."""

    def __post_init__(self) -> None:
        """Move a label to its facts. Raises ValueError for a camera without pixels."""
        if self.label:
            facts = msgspec.structs.replace(self.facts, label=self.facts.label or self.label)
            msgspec.structs.force_setattr(self, "facts", facts)
            msgspec.structs.force_setattr(self, "label", "")
        if not (self.facts.width and self.facts.height):
            raise ValueError(f"{self.name} has no pixels: {self.facts.width}x{self.facts.height}")

    def widen(self, image: T) -> T:
        """Return an image's record with the errors of the intervals in `widened` that it was taken in."""
        for widening in self.widened:
            if (
                image.local_ns is not None
                and widening.from_local_ns <= image.local_ns <= widening.until_local_ns
            ):
                bound_ns = image.hard_bound_ns
                image = msgspec.structs.replace(
                    image,
                    uncertainty_ns=max(image.uncertainty_ns or 0, widening.uncertainty_ns),
                    hard_bound_ns=None if bound_ns is None else max(bound_ns, widening.hard_bound_ns),
                )
        return image

    def is_late(self, residual_ns: int) -> bool:
        """Return whether an image taken `residual_ns` from its instant exceeds the camera's tolerance."""
        tolerance_ns = self.phase.tolerance_ns if self.phase else None
        return tolerance_ns is not None and abs(residual_ns) > tolerance_ns


class SkippedFrame(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A frame whose absence made an instant incomplete, and the reason."""

    camera: Name
    reason: Sentence
    dropped: bool = False
    """Whether the camera dropped the frame; False if it was lost later."""


class SkippedInstant(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An instant that was left out of the burst because at least one camera had no frame."""

    leader_ns: TimeNs
    missing: tuple[SkippedFrame, ...]


class AbsentCamera(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A camera of the rig that took no part in the burst, and the reason."""

    name: Name
    reason: Sentence
    label: Label = ""
    """As in a camera's facts."""


class BurstRecord(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Instants of the burst and the moment requested, in ns of the leader's clock."""

    instants_ns: tuple[TimeNs, ...]
    period_ns: Positive
    """Spacing of the rig's grid; instants are whole multiples of it apart."""
    requested_ns: TimeNs | None = None
    skipped: tuple[SkippedInstant, ...] = ()
    """Instants left out because a camera had no frame; later instants replaced them."""
    common_times: CommonTimes | None = None
    """State of an imported recording's times; None for a session of one rig, whose times share a clock."""
    absent: tuple[AbsentCamera, ...] = ()
    """Cameras that the rig had within the last ten minutes, or that had no room, and that took no part."""
    ordered: Positive | None = None
    """Number of instants ordered, where every camera ended before the last, as a killed leader's own do."""

    @property
    def absence(self) -> str:
        """What was ordered and not taken, in words: "cam02 missing: lost 12 s before"; empty for nothing."""
        lacks = [f"{camera.label or camera.name} missing: {camera.reason}" for camera in self.absent]
        return ", ".join(filter(None, (self.shortfall, *lacks)))

    @property
    def shortfall(self) -> str:
        """Number of the ordered instants that were taken, in words; empty if all were."""
        if self.ordered is None:
            return ""
        return f"cut off after {len(self.instants_ns)} of {self.ordered} instants"


class ImageRecord(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, gc=False):
    """One image: its camera and instant, its times by both clocks with their errors, and its checksum."""

    camera: Name
    instant: Count
    path: FilePath
    leader_ns: TimeNs
    bytes: Positive
    sha256: Sha256
    local_ns: TimeNs | None = None
    residual_ns: TimeNs = 0
    """leader_ns minus the instant's time and the camera's planned delay."""
    uncertainty_ns: Count | None = None
    hard_bound_ns: Count | None = None
    exposure_start_ns: TimeNs | None = None
    """Leader time at which the first row's exposure begins; None if the timestamps do not determine it."""
    exposure_ns: Count | None = None
    gain: Real | None = None
    white_balance: tuple[Real, Real] | None = None
    sequence: Count | None = None
    """Number of the frame: the driver's, or of an imported camera its place in the film or folder, from 0."""
    outlier_ns: TimeNs = 0
    """Correction of an outlier: the driver's timestamp minus the time on the line of its stream; mostly 0."""
    alignment_offset_ns: TimeNs = 0
    """Time from the frame's timestamp to `local_ns`; not 0 if the rig aligns mid-exposures."""
    substitute: bool = False
    """Whether this is the next best frame, because the camera dropped the one nearest to the instant."""
    late: bool = False
    """Whether the image's time differs from its instant, either way, by more than the camera's tolerance."""


class FrameRecord(ImageRecord, frozen=True, kw_only=True, omit_defaults=True):
    """A frame of a video as an image of its session; `path` is the video's. Manifests do not list frames.

    The file beside the video has a line for each frame. The line omits the fields that follow from the video
    and the instants.
    """

    offset: Count
    """Offset of the frame's first byte in the video."""
    camera: Name = ""
    path: FilePath = ""
    instant: Count = NO_INSTANT
    true_ns: TimeNs | None = None
    """True start of the first row's exposure in the host's clock, for a simulated frame."""


class VideoRecord(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One camera's video, or a part of it: its frames as consecutive JPEG files (MJPEG).

    The file beside it has one line, a `FrameRecord`, for each frame.
    """

    camera: Name
    path: FilePath
    frames: Count
    bytes: Count


class MissingImage(SkippedFrame, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An image that is missing from the burst, and the reason."""

    instant: Count


class SyncRecord(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Synchronization of a burst's cameras, computed from the records of its images; times in ns."""

    spread_ns: tuple[Count, ...]
    """Time from the first to the last image (`leader_ns`, without the planned delay) of each instant; 0 for
    fewer than two images."""
    row_spread_ns: Count | None = None
    """Largest time between two cameras' mid-exposures of the same row, over all instants, without planned
    delays. It includes differences between rolling shutters. None unless two cameras report their exposure
    and row time.
    """
    uncertainty_ns: Count | None = None
    """Largest uncertainty of an image's time against the others; None if any is unknown.

    If stamps were measured against different reference cameras, the unknown error of those references is
    included.
    """
    hard_bound_ns: Count | None = None
    dropped: Count = 0
    """Number of images that are missing because their camera dropped the frame."""
    substituted: Count = 0
    late: Count = 0


class Manifest(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Contents of `session.json`, which is written last: a session that has it is complete."""

    name: Name
    created: str
    """RFC 3339, UTC."""
    origin: str
    """captured, simulated or imported."""
    software: str
    cameras: tuple[CameraRecord, ...]
    burst: BurstRecord
    images: Sequence[ImageRecord]
    missing: tuple[MissingImage, ...] = ()
    sync: SyncRecord | None = None
    rig: Name = RIG
    schema_version: int = SCHEMA_VERSION
    note: str = ""
    videos: tuple[VideoRecord, ...] = ()
    """Videos of a recording, one for each camera; their frames are images, but are not listed in `images`."""
    label: Label | UnsetType = UNSET
    """What its owner calls the session, in any script; absent if that is its name."""

    @property
    def labels(self) -> dict[str, str]:
        """What people call each camera, by its name; beside the name, if they call several so."""
        return titles_of({camera.name: camera.facts.called(camera.name) for camera in self.cameras})

    @property
    def expected_images(self) -> int:
        """Number of images that were ordered, also of absent cameras and of instants that were not taken."""
        return (len(self.cameras) + len(self.burst.absent)) * self.ordered_instants

    @property
    def ordered_instants(self) -> int:
        """Number of ordered instants, taken or not."""
        return self.burst.ordered or len(self.burst.instants_ns)

    @property
    def is_staggered(self) -> bool:
        """Whether its cameras took their images one after the other, as planned, and not at one instant."""
        return len({camera.delay_ns for camera in self.cameras}) > 1

    @property
    def steps(self) -> str:
        """The planned steps between the images of a staggered session; empty for any other."""
        return describe_steps(camera.delay_ns for camera in self.cameras) if self.is_staggered else ""


def image_path(camera: str, instant: int, suffix: str = ".jpg") -> str:
    """Return an image's path inside its session; images of one instant share a file name, as in COLMAP."""
    return f"{IMAGES}/{RIG}/{camera}/{instant:06d}{suffix}"


def check_image_path(record: ImageRecord) -> str:
    """Return the suffix of an image's path. Raises BadInputError if the path is not that image's."""
    suffix = PurePosixPath(record.path).suffix
    if suffix not in IMAGE_SUFFIXES or record.path != image_path(record.camera, record.instant, suffix):
        raise BadInputError(
            f"{record.path!r} is not a valid path for an image of {record.camera}", hint=RESTORE
        )
    return suffix


def video_path(camera: str, part: int = 0) -> str:
    """Return the path of a part of a camera's video inside its session; no camera's name has a '+'."""
    return f"{VIDEOS}/{RIG}/{camera}{f'+{part + 1}' if part else ''}.mjpeg"


def video_of(stem: str) -> tuple[str, int]:
    """Return the camera of a video's file name without its suffix, and the number of its part."""
    camera, _, part = stem.partition("+")
    return camera, int(part) - 1 if part.isdecimal() else 0


@dataclass(frozen=True, slots=True)
class RowExposures:
    """The exposure of an image's rows in leader time, ns; row 0 is the top one and is read first."""

    first_start_ns: int
    exposure_ns: int
    row_time_ns: int
    rows: int

    def middle_ns(self, row: int) -> int:
        """Return the middle of a row's exposure: the moment that its pixels show."""
        return self.first_start_ns + row * self.row_time_ns + self.exposure_ns // 2


def row_exposures(camera: CameraRecord, image: ImageRecord) -> RowExposures | None:
    """Return the exposures of an image's rows; None if its start, exposure or row time is unknown."""
    row_time_ns, rows = camera.facts.row_time_ns, camera.facts.height
    if image.exposure_start_ns is None or image.exposure_ns is None or row_time_ns is None:
        return None
    return RowExposures(image.exposure_start_ns, image.exposure_ns, row_time_ns, rows)


def sync_record(
    cameras: Iterable[CameraRecord],
    burst: BurstRecord,
    images: Iterable[ImageRecord],
    missing: Sequence[MissingImage],
) -> SyncRecord:
    """Compute the sync record of a burst from its images' records, over all cameras and instants.

    The images of an instant must be consecutive, as in a manifest. `images` may be an iterator, so that a
    recording's images need not all be in memory.
    """
    by_name = {camera.name: camera for camera in cameras}
    facts = {name: camera.facts for name, camera in by_name.items()}
    # Times that were found from the pictures or the sound themselves are right whatever the stamps are.
    unshared_ns = dict.fromkeys(facts, 0) if burst.common_times else unshared_uncertainties_ns(facts)
    spreads_ns = [0] * len(burst.instants_ns)
    rows_ns: int | None = None
    error_ns: int | None = 0
    bound_ns: int | None = 0
    number = substituted = late = 0
    for instant, group in groupby(images, key=lambda image: image.instant):
        widened = [by_name[image.camera].widen(image) for image in group]
        number += len(widened)
        spreads_ns[instant] = _range_ns(
            [image.leader_ns - by_name[image.camera].delay_ns for image in widened]
        )
        if (rows := _row_scatter([(by_name[image.camera], image) for image in widened])) is not None:
            rows_ns = max(rows_ns or 0, rows)
        for image in widened:
            known_ns = image.uncertainty_ns
            shared_ns = None if known_ns is None else known_ns + unshared_ns[image.camera]
            error_ns, bound_ns = _worse(error_ns, shared_ns), _worse(bound_ns, image.hard_bound_ns)
            substituted += image.substitute
            late += image.late
    return SyncRecord(
        spread_ns=tuple(spreads_ns),
        row_spread_ns=rows_ns,
        uncertainty_ns=error_ns if number else None,
        hard_bound_ns=bound_ns if number else None,
        dropped=sum(absence.dropped for absence in missing),
        substituted=substituted,
        late=late,
    )


def computed_sync(manifest: Manifest) -> SyncRecord:
    """Compute the sync record of a manifest's images in any order, ignoring the record that it stores."""
    return sync_record(
        manifest.cameras,
        manifest.burst,
        sorted(manifest.images, key=lambda image: image.instant),
        manifest.missing,
    )


def _worse(worst: int | None, number: int | None) -> int | None:
    """Return the larger of two numbers; None if either is None."""
    return None if worst is None or number is None else max(worst, number)


def _range_ns(times_ns: Sequence[int]) -> int:
    return max(times_ns) - min(times_ns) if times_ns else 0


def _row_scatter(images: Sequence[tuple[CameraRecord, ImageRecord]]) -> int | None:
    """Return the largest time between mid-exposures of equal rows; the first and last row suffice."""
    rows = [
        (camera.delay_ns, known)
        for camera, image in images
        if (known := row_exposures(camera, image)) is not None
    ]
    if len(rows) < 2:
        return None
    shared = 0, min(row.rows for _, row in rows) - 1
    return max(_range_ns([image.middle_ns(row) - delay_ns for delay_ns, image in rows]) for row in shared)


def inside(folder: Path, path: str) -> Path:
    """Return the file at a path that a manifest states; the file need not exist.

    Raises BadInputError if the path leads out of the folder, or is a pipe or a device.
    """
    parts = PurePosixPath(path).parts
    safe = parts and not path.startswith("/") and ".." not in parts and not set(path) & {"\\", "\0"}
    file, what = folder / path, "outside the session"
    try:
        if safe and file.resolve().is_relative_to(folder.resolve()):
            # From Python 3.13 on a loop of links resolves, and fails only here.
            mode = file.stat().st_mode
            if stat.S_ISREG(mode) or stat.S_ISDIR(mode):
                return file
            what = "not a regular file"
    except (FileNotFoundError, NotADirectoryError):
        return file
    except (OSError, RuntimeError):
        pass
    raise BadInputError(f"{folder / MANIFEST} names {path!r}, which is {what}", hint=RESTORE)


class PathCheck:
    """Check of paths that a manifest states, as by `inside`; a session may have a million images.

    A folder is looked at once: if all in it are regular files and no links, so is what a path there names.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._is_plain: dict[str, bool] = {}

    def __call__(self, path: str) -> None:
        """Raise BadInputError as `inside` does."""
        parent, _, name = path.rpartition("/")
        if parent and parent not in self._is_plain:
            self._is_plain[parent] = _has_only_files(inside(self._folder, parent))
        if not self._is_plain.get(parent) or not name.strip(".") or "\\" in name or "\0" in name:
            inside(self._folder, path)


def _has_only_files(folder: Path) -> bool:
    """Return whether a folder exists and contains nothing but regular files, none of them a link."""
    try:
        with os.scandir(folder) as entries:
            return all(entry.is_file(follow_symlinks=False) for entry in entries)
    except OSError:
        return False


def check_references(path: Path, manifest: Manifest) -> None:
    """Check a manifest's names and numbers, and that its images belong to its cameras and instants.

    Raises BadInputError, with `path`, for the first violation.
    """
    names = [camera.name for camera in manifest.cameras]
    defects = (
        (not manifest.burst.instants_ns, "has no instants"),
        (not names, "has no cameras"),
        (len(set(names)) != len(names), "lists a camera twice"),
    )
    for what in (what for applies, what in defects if applies):
        raise BadInputError(f"{path} {what}", hint=RESTORE)
    parts: dict[str, Sequence[ImageRecord | MissingImage]] = {
        "images": manifest.images,
        "missing": manifest.missing,
    }
    for part, records in parts.items():
        for i, record in enumerate(records):
            if record.camera not in names:
                what = f"camera, {record.camera}"
            elif record.instant >= len(manifest.burst.instants_ns):
                what = f"instant, {record.instant}"
            else:
                continue
            raise BadInputError(f"{path}: {part}[{i}] is of an unknown {what}", hint=RESTORE)


def session_schema_text() -> str:
    """Return the JSON schema (draft 2020-12) of a manifest, the text of `docs/session.schema.json`."""
    schema = msgspec.json.schema(Manifest)
    for struct in schema["$defs"].values():
        if "description" in struct:
            # From Python 3.13 on docstrings come without their indentation, before that with it.
            struct["description"] = inspect.cleandoc(struct["description"])
        for about_field in struct.get("properties", {}).values():
            if "$ref" in about_field.get("propertyNames", {}):
                # From msgspec 0.23 on, of names that are an enumeration's.
                del about_field["propertyNames"]
    about = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "simulshot session manifest (session.json)",
    }
    return pretty_json(about | schema).decode() + "\n"
