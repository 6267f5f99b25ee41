"""Recordings that can be replayed (sessions, videos, images), and the timing of their playback."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from statistics import median

from msgspec.structs import replace

from capture_app.cameras.frames import JpegPicture
from capture_app.common.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.journal import frame_of_line
from capture_app.session.format.manifest import NO_INSTANT, CameraRecord, ImageRecord
from capture_app.session.importing.recording_sources import Images, Source, Video
from capture_app.session.reading.decoding import JPEG_BEGIN, decode_image, encode_image, is_whole_jpeg
from capture_app.session.reading.reader import Session

KIND = "replay"
TYPICAL_FPS = 30.0
SPARSE = 1.5
"""Instants further apart than this many periods are a selection from the camera's stream."""
SAME_PERIOD = 0.01
"""Share by which a camera's period may differ from its rig's: quartz and rounding, not another rate."""


@dataclass(frozen=True, slots=True)
class RecordedTiming:
    """Ascending times of the frames, in ns from the recording's beginning; one loop lasts `loop_ns`."""

    period_ns: int
    loop_ns: int
    at_ns: tuple[int, ...]


class Playback:
    """Schedules frames at the intervals they were recorded with, in a loop."""

    def __init__(self, timing: RecordedTiming, *, restarts: bool = False) -> None:
        """Create the schedule: the recording begins at every multiple of its loop from time 0.

        That keeps several cameras of one recording together. If it `restarts`, a stream begins at the time
        that is asked for, with the frame nearest to it.
        """
        self._timing, self._restarts = timing, restarts
        times_ns = (*timing.at_ns, timing.at_ns[0] + timing.loop_ns)
        steps = (max(1, round((after - before) / timing.period_ns)) for before, after in pairwise(times_ns))
        # The camera's number of each frame, from 0, and of the first one in the next loop; gaps are drops.
        *self._slots, self._loop_slots = accumulate(steps, initial=0)
        self._next = 0
        """Number of the next frame, counted over all loops."""
        self._stream = -1

    def start(self, at_ns: int) -> None:
        """Begin a stream with the frame due at `at_ns`, or with the nearest one, at that time."""
        self._stream += 1
        self._base_ns, timing = 0, self._timing
        due_ns = at_ns - timing.period_ns // 2 if self._restarts else at_ns
        self._next = (due_ns - timing.at_ns[0]) // timing.loop_ns * len(timing.at_ns)
        while self._due()[2] < due_ns:
            self._next += 1
        if self._restarts:
            self._base_ns = at_ns - self._due()[2]
        _, self._first_slot, _ = self._due()

    def lengthen_frame(self, duration_ns: int) -> None:
        """Set the duration (ns) of the next frame instead of a period, which shifts all later frames."""
        self._base_ns += duration_ns - self._timing.period_ns

    def next_frame(self) -> tuple[int, int, int, int]:
        """Return the next frame of the stream: its index in the recording, sequence, stream, and start.

        The start is in ns of the host's monotonic clock.
        """
        index, slot, start_ns = self._due()
        self._next += 1
        return index, slot - self._first_slot, self._stream, start_ns

    def _due(self) -> tuple[int, int, int]:
        """Return the next frame's index in the recording, its number since the first loop, and its start."""
        loop, index = divmod(self._next, len(self._slots))
        start_ns = self._base_ns + loop * self._timing.loop_ns + self._timing.at_ns[index]
        return index, loop * self._loop_slots + self._slots[index], start_ns


def timing_of_video(times_ns: Sequence[int], period_ns: int) -> RecordedTiming:
    """Return the timing of frames with these ascending times."""
    at_ns = tuple(time - times_ns[0] for time in times_ns)
    return RecordedTiming(period_ns, at_ns[-1] + period_ns, at_ns)


class Recording(ABC):
    """Recorded frames of one camera with their timing; base class of the kinds of recordings."""

    facts: CameraFacts
    timing: RecordedTiming
    calibration: CameraCalibration | None = None

    @abstractmethod
    def picture(self, index: int) -> JpegPicture | None:
        """Return the image of a frame, None if it is broken. May block; raises OSError, BadInputError."""

    def record(self, index: int) -> ImageRecord | None:
        """Return a frame's metadata, such as its exposure; None if there are none."""
        return None


class SessionRecording(Recording):
    """One camera of a session, with its own period, jitter and drops, in the rig's common time."""

    def __init__(self, session: Session, camera: CameraRecord) -> None:
        """Read a camera's frames. Raises BadInputError for a camera without images, or a broken session."""
        self._session = session
        facts, burst = camera.facts, session.stored_manifest.burst
        # The rig's period, as each camera's own differs a little, and all loops have to be equally long.
        same = abs(facts.period_ns - burst.period_ns) < SAME_PERIOD * burst.period_ns
        period_ns, instants_ns = burst.period_ns if same else facts.period_ns, burst.instants_ns
        lasts_ns = instants_ns[-1] - instants_ns[0]
        sparse = lasts_ns > SPARSE * period_ns * (len(instants_ns) - 1)
        if sparse:
            # Use one instant per period: a camera without a frame in most of its periods would be useless.
            lasts_ns = (len(instants_ns) - 1) * period_ns
        placed = [
            (self._at_ns(image, instants_ns, period_ns if sparse else None), image)
            for image in _images_of(session, camera.name, with_others=not sparse)
        ]
        # Drop frames far outside the instants: their number varies by camera, the loop length must not.
        in_loop = [frame for frame in placed if -period_ns <= 2 * frame[0] < 2 * lasts_ns + period_ns]
        in_loop.sort(key=lambda frame: frame[0])
        if not in_loop:
            raise BadInputError(
                f"{camera.name} has no picture in {session.folder}",
                hint=f"see its images: capture-app sessions show {session.folder}",
            )
        self._images = [image for _, image in in_loop]
        self.timing = RecordedTiming(period_ns, lasts_ns + period_ns, tuple(at_ns for at_ns, _ in in_loop))
        movable = facts.phase_control in (PhaseControl.RESET, PhaseControl.FRAME_DURATION)
        tells_start = all(image.exposure_start_ns is not None for image in self._images)
        self.facts = replace(
            facts,
            kind=KIND,
            model=f"{facts.model} of {session.name}"[:200],
            timestamp_source=TimestampSource.START_OF_EXPOSURE if tells_start else TimestampSource.UNKNOWN,
            phase_control=facts.phase_control if movable else PhaseControl.FRAME_DURATION,
            min_frame_duration_ns=None,
            max_frame_duration_ns=None,
            # A known bias is already subtracted from the times; its uncertainty remains.
            stamp=replace(facts.stamp_accuracy, bias_ns=0) if tells_start else None,
        )
        calibration = session.calibration()
        self.calibration = calibration.cameras.get(camera.name) if calibration else None

    def picture(self, index: int) -> JpegPicture | None:
        """Return the image of a frame; see `Recording.picture`."""
        return _jpeg(self._session.image_bytes(self._images[index]))

    def record(self, index: int) -> ImageRecord:
        """Return the frame's record; see `Recording.record`."""
        return self._images[index]

    @staticmethod
    def _at_ns(image: ImageRecord, instants_ns: Sequence[int], period_ns: int | None) -> int:
        """Return a frame's start, ns since the first instant; `period_ns` replaces the instants' spacing."""
        start_ns = image.exposure_start_ns
        if start_ns is None:
            start_ns = image.leader_ns - image.alignment_offset_ns
        instant = 0 if period_ns is None else image.instant
        return instant * (period_ns or 0) + start_ns - instants_ns[instant]


class SourceRecording(Recording):
    """Recording in a video or a folder of images; frames without embedded times are evenly spaced."""

    def __init__(self, source: Source, fps: float | None) -> None:
        """Read the timing; `fps` overrides the recording's own. Raises BadInputError if it is unreadable."""
        self._source = source
        self._frames: Iterator[tuple[int, bytes, tuple[int, int]]] = iter(())
        self._read: tuple[int, bytes] = (-1, b"")
        self._reading = threading.Lock()
        """Held by a thread that reads: one whose stream was restarted goes on for a while."""
        times_ns = _times_ns(source, fps)
        steps_ns = [after - before for before, after in pairwise(times_ns)]
        median_ns = median(steps_ns) if steps_ns else 1e9 / (fps or TYPICAL_FPS)
        regular_ns = [step for step in steps_ns if step < SPARSE * median_ns]
        # The mean without the gaps of dropped frames; the median alone would be rounded.
        period_ns = round(sum(regular_ns) / len(regular_ns)) if regular_ns else round(median_ns)
        if period_ns <= 0:
            raise BadInputError(f"the times of {source.path} do not ascend", hint="give its rate, as fps=30")
        self.timing = timing_of_video(times_ns, period_ns)
        first = next(source.frames([0]), None)
        if first is None:
            raise BadInputError(
                f"{source.path} is not a video that can be decoded",
                hint="check that a video player plays it, or convert it to H.264",
            )
        self.facts = CameraFacts(
            kind=KIND,
            model=source.path.name[:200],
            width=first[2][0],
            height=first[2][1],
            period_ns=period_ns,
            timestamp_source=TimestampSource.UNKNOWN,
            phase_control=PhaseControl.RESET,
        )

    def picture(self, index: int) -> JpegPicture | None:
        """Return the image of a frame; a video, decoded in order, is fast only for ascending frames."""
        if isinstance(self._source, Images):
            return _jpeg(self._source.read(index))
        with self._reading:
            if index <= self._read[0] or not self._read[1]:
                self._frames = self._source.frames(range(index, len(self.timing.at_ns)))
                self._read = (-1, b"")
            while self._read[0] < index:
                number, data, _size = next(self._frames, (len(self.timing.at_ns), b"", (0, 0)))
                self._read = number, data
            return _jpeg(self._read[1]) if self._read[0] == index else None


def _images_of(session: Session, camera: str, *, with_others: bool) -> list[ImageRecord]:
    """Return a camera's frames; `with_others` includes frames of its video outside all instants."""
    images = [image for image in session.manifest.images if image.camera == camera]
    return images + [
        replace(frame_of_line(video, frame), instant=0)
        for video in (session.stored_manifest.videos if with_others else ())
        if video.camera == camera
        for frame in session.video_frames(video)
        if frame.instant == NO_INSTANT
    ]


def _times_ns(source: Source, fps: float | None) -> Sequence[int]:
    """Return each frame's time: embedded in the recording, else computed from its rate."""
    if fps is None:
        if (embedded := source.embedded_times()) is not None:
            return [frame.leader_ns for frame in embedded]
        if isinstance(source, Video):
            if times_ns := source.own_times_ns():
                return times_ns
            fps = source.fps
    return [round(number * 1e9 / (fps or TYPICAL_FPS)) for number in range(len(source.numbers))]


def _jpeg(data: bytes) -> JpegPicture | None:
    """Return an image as JPEG: unchanged if it is one, else encoded again."""
    if data.startswith(JPEG_BEGIN):
        return JpegPicture(data) if is_whole_jpeg(data) else None
    image = decode_image(data, colour=True)
    return None if image is None else JpegPicture(encode_image(image))
