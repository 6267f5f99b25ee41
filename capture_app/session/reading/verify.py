"""Session verification: every image is checked against the manifest, the clock records and the journal."""

import hashlib
from collections import Counter
from collections.abc import Iterator
from functools import partial
from itertools import pairwise, product
from typing import Literal

import msgspec

from capture_app.common.errors import BadInputError
from capture_app.session.files.durable import PART
from capture_app.session.files.untrusted_files import read_regular
from capture_app.session.format.journal import frames_path, ground_truth_path, lines_of_file, record_of_line
from capture_app.session.format.manifest import (
    CALIBRATION,
    IMAGES,
    JOURNAL,
    MANIFEST,
    VIDEOS,
    CameraRecord,
    FrameRecord,
    ImageRecord,
    computed_sync,
)
from capture_app.session.reading.checksums import changed_files
from capture_app.session.reading.decoding import decode_image, size_of
from capture_app.session.reading.reader import INCOMING, Session, WritingState, writing_state

_ROUNDING_NS = 1_000
_ONE_MAP_NS, _WANDER = 2_000_000_000, 520e-6
"""Frames of a recording, and of a burst longer than this, use the newest clock map.

Its rate may differ by up to `_WANDER`: quartz wanders by up to 20 ppm, and adjtime and ntpd slew a clock by
up to 500 ppm while a recording goes on.
"""
DECODED_EACH = 30
"""Interval, in instants, between fully decoded frames of a video; of the others only headers are read."""


ProblemKind = Literal["missing", "changed", "unreadable", "contradictory", "unexpected"]


class Problem(msgspec.Struct, frozen=True):
    """One defect, with the path inside the session where it is."""

    kind: ProblemKind
    where: str
    what: str

    def __str__(self) -> str:
        return f"{self.where}: {self.what}"


_contradiction = partial(Problem, "contradictory")


def verify(session: Session) -> list[Problem]:
    """Check every file and every number of a session; return the defects, none if all agree.

    While its late images arrive, what was finished before is checked.
    """
    version = _version(session)
    while (problems := _verify(session, version[0])) and (latest := _version(session)) != version:
        # It was finished, or opened again, meanwhile.
        session, version = Session.open(session.folder), latest
    return problems


def _version(session: Session) -> tuple[WritingState, int]:
    """Return what changes whenever a session is opened again or finished."""
    return writing_state(session.folder), (session.folder / MANIFEST).stat().st_mtime_ns


def _verify(session: Session, state: WritingState) -> list[Problem]:
    is_open = state != "finished"
    lost = Problem("missing", INCOMING, "its leader ended while late images arrived")
    return [
        *([lost] if state == "interrupted again" else []),
        *_burst(session),
        *_order(session),
        *_sync(session),
        *(problem for record in session.manifest.images for problem in _image(session, record)),
        *_videos(session, is_open),
        *_journal(session, is_open),
        *(Problem("changed", where, what) for where, what in changed_files(session.folder, is_open=is_open)),
        *_calibration(session),
        *_ground_truth(session),
        *(() if is_open else _unexpected(session)),
    ]


def _burst(session: Session) -> Iterator[Problem]:
    manifest = session.manifest
    for index, (before, after) in enumerate(pairwise(manifest.burst.instants_ns)):
        if after <= before:
            yield _contradiction(MANIFEST, f"instant {index + 1} is not after instant {index}")
    images = Counter((image.camera, image.instant) for image in manifest.images)
    missing = {(absence.camera, absence.instant) for absence in manifest.missing}
    for camera, instant in product(manifest.cameras, range(len(manifest.burst.instants_ns))):
        place = f"of {camera.name} at instant {instant}"
        number = images[camera.name, instant]
        if number > 1:
            yield _contradiction(MANIFEST, f"{number} images {place}")
        if number and (camera.name, instant) in missing:
            yield _contradiction(MANIFEST, f"the image {place} is there and missing")
        elif not number and (camera.name, instant) not in missing:
            yield _contradiction(MANIFEST, f"no image {place}, nor why it is missing")


def _order(session: Session) -> Iterator[Problem]:
    """Check that the times of each camera's images increase, in its own clock and in the leader's."""
    images = sorted(session.manifest.images, key=lambda image: (image.camera, image.instant))
    for last, record in pairwise(images):
        # A machine that is started again within a recording begins its clock anew.
        own = () if session.camera(record.camera).widened else ((last.local_ns, record.local_ns),)
        pair = ((last.leader_ns, record.leader_ns), *own)
        backwards = any(one is not None and other is not None and other <= one for one, other in pair)
        if record.camera == last.camera and record.instant != last.instant and backwards:
            yield _contradiction(record.path, f"was not taken after {last.path}")


def _sync(session: Session) -> Iterator[Problem]:
    manifest = session.manifest
    for name, expected in msgspec.structs.asdict(computed_sync(manifest)).items() if manifest.sync else ():
        if (stored := getattr(manifest.sync, name)) != expected:
            yield _contradiction(
                MANIFEST, f"sync.{name} is {stored}; computed from the images it is {expected}"
            )


def _image(session: Session, record: ImageRecord) -> Iterator[Problem]:
    yield from _times(session, record)
    try:
        data = session.image_bytes(record)
    except FileNotFoundError:
        # `_videos` reports a missing video once; here it would be reported once a frame.
        if not isinstance(record, FrameRecord):
            yield Problem("missing", record.path, "the image is missing")
        return
    except OSError as error:
        yield Problem("unreadable", record.path, f"cannot be read: {error.strerror}")
        return
    if len(data) != record.bytes:
        yield Problem("changed", record.path, f"{len(data)} bytes long, not {record.bytes}")
    elif hashlib.sha256(data).hexdigest() != record.sha256:
        yield Problem("changed", record.path, "its bytes have changed: the sha256 differs")
    # Ten minutes of video are 18,000 images: decoding one in 30 still detects a broken encoder.
    in_full = not isinstance(record, FrameRecord) or record.instant % DECODED_EACH == 0
    yield from _picture(record.path, data, session.camera(record.camera), in_full=in_full)


def _picture(path: str, data: bytes, camera: CameraRecord, *, in_full: bool) -> Iterator[Problem]:
    size, own = size_of(data), (camera.facts.width, camera.facts.height)
    # An image of a different size need not be decoded, and might not fit into memory.
    # An eighth of the size reads all of the file's data, and fails where the whole size does.
    if size == own and in_full and decode_image(data, colour=True, min_width=1) is None:
        size = None
    if size is None:
        yield Problem("unreadable", path, "not an image that can be decoded")
    elif size != own:
        yield _contradiction(path, f"{size[0]}x{size[1]} pixels; {camera.name} takes {own[0]}x{own[1]}")


def _times(session: Session, record: ImageRecord) -> Iterator[Problem]:
    """Check an image's times against its instant, its camera's clock, and the timestamp delay."""
    burst, camera = session.manifest.burst, session.camera(record.camera)
    residual_ns = record.leader_ns - burst.instants_ns[record.instant] - camera.delay_ns
    start_ns = camera.facts.exposure_start_ns(
        record.leader_ns - record.alignment_offset_ns, record.exposure_ns
    )
    tolerance_ns = camera.phase.tolerance_ns if camera.phase else None
    stamp = camera.facts.stamp
    counts = camera.clock is not None and burst.common_times is None
    min_ns = 0 if stamp is None else stamp.uncertainty_ns
    stated_ns = record.uncertainty_ns
    error_ns, allowed_ns = _clock_error(session, record, camera, min_ns)
    checks = (
        (
            record.residual_ns != residual_ns,
            f"residual_ns is {record.residual_ns}; by leader_ns it is {residual_ns}",
        ),
        (
            record.exposure_start_ns not in (None, start_ns),
            f"exposure_start_ns is {record.exposure_start_ns}; by leader_ns it is {start_ns}",
        ),
        (
            counts and stated_ns is not None and stated_ns < min_ns,
            f"uncertainty_ns is {stated_ns}; its camera's stamps alone have {min_ns}",
        ),
        (
            counts and record.hard_bound_ns is not None and stamp is not None and not stamp.is_exact,
            "has a hard bound; its camera's stamps have none",
        ),
        (
            tolerance_ns is not None and record.late != camera.is_late(record.residual_ns),
            f"is marked {'late' if record.late else 'not late'}, "
            f"{record.residual_ns} ns from its instant with {tolerance_ns} ns allowed",
        ),
        (
            abs(error_ns) > allowed_ns,
            f"leader_ns differs by {error_ns} ns from local_ns converted by the clock record",
        ),
    )
    yield from (_contradiction(record.path, what) for wrong, what in checks if wrong)


def _clock_error(
    session: Session, record: ImageRecord, camera: CameraRecord, stamp_ns: int
) -> tuple[int, int]:
    """Return an image's leader time minus its converted local time, and the limit of that, in ns."""
    clock, instants_ns = camera.clock, session.manifest.burst.instants_ns
    if clock is None or record.local_ns is None:
        return 0, 0
    # The timestamp delay does not affect clock conversion, so its uncertainty is subtracted.
    own_ns = (
        clock.uncertainty_ns if record.uncertainty_ns is None else max(0, record.uncertainty_ns - stamp_ns)
    )
    allowed_ns = own_ns + _ROUNDING_NS
    # The clock record is from before; these changes were noticed later.
    allowed_ns += sum(
        widening.uncertainty_ns for widening in camera.widened if record.local_ns >= widening.from_local_ns
    )
    if isinstance(record, FrameRecord) or instants_ns[-1] - instants_ns[0] > _ONE_MAP_NS:
        allowed_ns += clock.uncertainty_ns + round(_WANDER * abs(record.leader_ns - instants_ns[0]))
    return record.leader_ns - clock.leader_from_local(record.local_ns), allowed_ns


def _journal(session: Session, is_open: bool) -> Iterator[Problem]:
    try:
        lines = lines_of_file(read_regular(session.folder / JOURNAL))
    except OSError:
        yield Problem("missing", JOURNAL, "the journal is missing")
        return
    saved: dict[tuple[str, int], ImageRecord] = {}
    for number, line in enumerate(lines, 1):
        if (record := record_of_line(line, ImageRecord)) is None and is_open:
            continue  # it may be only half there
        if record is None:
            yield Problem("unreadable", JOURNAL, f"line {number} cannot be read as an image record")
        elif saved.setdefault((record.camera, record.instant), record) is not record:
            yield _contradiction(
                JOURNAL, f"line {number} repeats {record.camera} at instant {record.instant}"
            )
    for image in session.stored_manifest.images:
        if (listed := saved.pop((image.camera, image.instant), None)) is None:
            yield _contradiction(JOURNAL, f"has no entry for {image.path}")
        elif session.camera(listed.camera).widen(listed) != image:
            yield _contradiction(JOURNAL, f"differs from the manifest in {image.path}")
    for listed in () if is_open else saved.values():
        yield _contradiction(MANIFEST, f"lacks {listed.path}, which the journal has")


def _calibration(session: Session) -> Iterator[Problem]:
    try:
        calibration = session.calibration()
    except BadInputError as error:
        yield Problem("unreadable", CALIBRATION, str(error))
        return
    sizes = {camera.name: (camera.facts.width, camera.facts.height) for camera in session.manifest.cameras}
    for name, of in (calibration.cameras if calibration else {}).items():
        if name not in sizes:
            yield _contradiction(CALIBRATION, f"calibrates a camera {name} that the session does not have")
        elif (of.width, of.height) != sizes[name]:
            yield _contradiction(
                CALIBRATION, f"{name} is calibrated for {of.width}x{of.height} pixels, not its own size"
            )


def _ground_truth(session: Session) -> Iterator[Problem]:
    try:
        times = session.true_times()
    except BadInputError as error:
        yield Problem("unreadable", "ground_truth/times.json", str(error))
        return
    for true in (image for image in (times.images if times else ()) if image.sha256 is not None):
        where = ground_truth_path(true.camera, true.instant)
        if (path := session.ground_truth(true.camera, true.instant)) is None:
            yield Problem("missing", where, "the ground truth is missing")
        elif hashlib.sha256(path.read_bytes()).hexdigest() != true.sha256:
            yield Problem("changed", where, "its bytes have changed: the sha256 differs")


def _videos(session: Session, is_open: bool) -> Iterator[Problem]:
    """Check that each video has the length in its record, and that its frames are contiguous."""
    for video in session.stored_manifest.videos:
        frames, path = session.video_frames(video, further=not is_open), session.folder / video.path
        if frames and not path.exists():
            yield Problem("missing", video.path, "the video is missing")
            continue
        size = path.stat().st_size if frames else video.bytes
        size = min(size, video.bytes) if is_open else size
        if (len(frames), size) != (video.frames, video.bytes):
            yield Problem(
                "changed",
                video.path,
                f"{len(frames)} frames in {size} bytes, not {video.frames} in {video.bytes}",
            )
        for number, (before, after) in enumerate(pairwise(frames), 1):
            if after.offset < before.offset + before.bytes:
                yield _contradiction(frames_path(video.path), f"frame {number} overlaps frame {number - 1}")


def _unexpected(session: Session) -> Iterator[Problem]:
    videos = [video.path for video in session.stored_manifest.videos]
    expected = {record.path for record in session.manifest.images} | {*videos, *map(frames_path, videos)}
    paths = [path for folder in (IMAGES, VIDEOS) for path in (session.folder / folder).rglob("*")]
    for path in sorted(paths):
        name = path.relative_to(session.folder).as_posix()
        if name not in expected and not (path.is_dir() and not path.is_symlink()):
            part = "left over from an interrupted write" if path.name.endswith(PART) else ""
            yield Problem("unexpected", name, part or "an image that is not in the manifest")
