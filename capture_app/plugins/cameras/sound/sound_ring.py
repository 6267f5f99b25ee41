"""Ring buffer of a microphone's samples, each at its time in the node's clock.

A microphone has a clock of its own, and only the arrival of its samples is seen: late, never early.
`ArrivalClock` fits it. Samples that arrive late wait for others. If these are in time again, there was only a
delay. If they stay late, samples were lost (an overrun), and silence takes their place.
"""

import secrets
import threading
from bisect import bisect_left, insort
from dataclasses import dataclass

import numpy as np

from capture_app.cameras.arrival_clock import ArrivalClock
from capture_app.plugins.cameras.sound.image_sound import MAX_PCM_BYTES, SoundPart, sound_segments

RATE_HZ = 48_000
RING_S = 60
MAX_CARRIED_S = 1
"""Maximum length of the sound in one image."""
LATE_NS = 20_000_000
"""Samples that arrive later than this after the fitted time wait; as early, they begin a new stream."""
LOST_AFTER_NS = 1_000_000_000
"""Time for which all samples are late before that counts as lost samples."""
SAME_NS = 5_000_000
"""Late samples within this of the least late ones were taken after the gap."""
MAX_LATE = 500
"""Maximum number of arrivals that wait: the times of a phone's are untrusted."""
MAX_GAP_NS = 10_000_000_000
"""A longer gap begins a new stream."""


@dataclass(frozen=True, slots=True)
class _Late:
    pcm: bytes
    arrival_ns: int
    late_ns: int


class SoundRing:
    """The latest samples of a microphone, mono, and which images carry them. Thread-safe."""

    def __init__(self, rate_hz: int = RATE_HZ) -> None:
        """Create it empty, for a microphone of that rate."""
        self._lock = threading.RLock()
        self._rate_hz = rate_hz
        self._samples = np.zeros(RING_S * rate_hz, np.int16)
        self.begin_stream()

    def begin_stream(self) -> None:
        """Begin a new stream: the microphone was started."""
        with self._lock:
            self._stream = secrets.randbits(32)
            self._clock = ArrivalClock()
            self._end = 0
            """Number of samples in this stream, lost ones included."""
            self._late: list[_Late] = []
            self._carried: list[tuple[int, int]] = []
            """Time of each encoded image, and the number of the sample after its last one."""

    def add(self, pcm: bytes, arrival_ns: int) -> None:
        """Add samples, the last of which was taken just before `arrival_ns` in the node's clock."""
        with self._lock:
            waiting = sum(len(chunk.pcm) for chunk in self._late) // 2
            due_ns = self._local_ns(self._end + waiting + len(pcm) // 2)
            late_ns = 0 if due_ns is None else arrival_ns - due_ns
            if late_ns < -LATE_NS:
                self.begin_stream()
            elif late_ns > LATE_NS:
                self._late.append(_Late(pcm, arrival_ns, late_ns))
                if arrival_ns - self._late[0].arrival_ns > LOST_AFTER_NS or len(self._late) > MAX_LATE:
                    self._insert_gap()
                return
            for piece in self._late:
                self._write(piece.pcm)
            self._late.clear()
            self._write(pcm)
            self._clock.add_arrival(self._counter_ns(self._end), arrival_ns)

    def _insert_gap(self) -> None:
        """Place the late samples after a gap of silence that is as long as the least late ones are late.

        Samples that were less late for a moment before, as after a delay that was ending, are before the gap.
        """
        late, self._late = self._late, []
        late_ns = [chunk.late_ns for chunk in late]
        typical_ns = sorted(late_ns)[len(late) // 4]
        before = max((n for n, ns in enumerate(late_ns[:-1]) if ns < typical_ns - SAME_NS), default=-1)
        gap_ns = min(late_ns[before + 1 :])
        if gap_ns > MAX_GAP_NS:
            self.begin_stream()
            return
        first = next(n for n, ns in enumerate(late_ns) if n > before and ns <= gap_ns + SAME_NS)
        for n, piece in enumerate(late):
            if n == first:
                self._write(bytes(2 * (gap_ns * self._rate_hz // 1_000_000_000)))
            self._write(piece.pcm)
            if n >= first:
                self._clock.add_arrival(self._counter_ns(self._end), piece.arrival_ns)

    def _write(self, pcm: bytes) -> None:
        samples = np.frombuffer(pcm, "<i2")
        size = len(self._samples)
        self._samples[(self._end + np.arange(len(samples))) % size] = samples
        self._end += len(samples)

    def _counter_ns(self, sample: int) -> int:
        return sample * 1_000_000_000 // self._rate_hz

    def _local_ns(self, sample: int) -> int | None:
        return self._clock.host_ns(self._counter_ns(sample))

    def _sample_at(self, local_ns: int) -> int:
        """Return the number of the sample at a time of the node's clock; there must have been an arrival."""
        counter_ns = self._counter_ns(self._end)
        for _ in range(3):
            counter_ns += local_ns - (self._clock.host_ns(counter_ns) or 0)
        return counter_ns * self._rate_hz // 1_000_000_000

    def carry(self, local_ns: int) -> bytes:
        """Return the JPEG segments for an image of that time, with the sound since the images before it.

        It is at most MAX_CARRIED_S of what has arrived before the image's time.
        """
        with self._lock:
            if not self._end:
                return b""
            end = min(self._end, self._sample_at(local_ns))
            before = bisect_left(self._carried, (local_ns, 0))
            carried = self._carried[before - 1][1] if before else 0
            first = max(carried, end - MAX_CARRIED_S * self._rate_hz, self._end - len(self._samples), 0)
            insort(self._carried, (local_ns, max(first, end)))
            # Images that are older than the ring find no sound.
            del self._carried[
                : bisect_left(self._carried, (self._carried[-1][0] - RING_S * 1_000_000_000, 0))
            ]
            return sound_segments(self._part(n, end) for n in range(first, end, MAX_PCM_BYTES // 2))

    def _part(self, first: int, end: int) -> SoundPart:
        numbers = np.arange(first, min(end, first + MAX_PCM_BYTES // 2))
        pcm = self._samples[numbers % len(self._samples)].astype("<i2").tobytes()
        return SoundPart(self._stream, first, self._rate_hz, 1, self._local_ns(first) or 0, pcm)
