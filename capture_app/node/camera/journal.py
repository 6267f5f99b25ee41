"""What a node keeps of its latest exchanges and lines, for whoever asks for its details."""

import time
from collections import deque
from pathlib import Path

from capture_app.cameras.base import CapturedFrame
from capture_app.node.wire.operating import Vitals
from capture_app.node.wire.views import NewsLine, NodeDetail
from capture_app.session.files.disk import free_bytes
from capture_app.sync.clock.clock_filter import ClockSample

SAMPLES_KEPT = 300
LINES_KEPT = 100


class NodeJournal:
    """One node's."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._samples: deque[ClockSample] = deque(maxlen=SAMPLES_KEPT)
        self._lines: deque[NewsLine] = deque(maxlen=LINES_KEPT)

    def add_sample(self, sample: ClockSample) -> None:
        """Keep an exchange with the leader."""
        self._samples.append(sample)

    def forget_samples(self) -> None:
        """Another leader has another clock."""
        self._samples.clear()

    def add_line(self, text: str) -> None:
        """Keep what the node has said."""
        self._lines.append(NewsLine(unix_ns=time.time_ns(), text=text, camera=self._name))

    def detail(
        self,
        vitals: Vitals,
        *,
        skew_ppm: float | None,
        phase_errors_ns: tuple[int, ...],
        newest: CapturedFrame | None,
        spool: Path | None,
    ) -> NodeDetail:
        """Return all of it, with how the camera runs and where its images wait.

        By `skew_ppm` the leader's clock gains on this one; its share is taken off the offsets, which then
        show by what the exchanges erred.
        """
        rate = (skew_ppm or 0.0) * 1e-6
        last_ns = self._samples[-1].t3_ns if self._samples else 0
        samples = tuple(
            (
                (sample.lower_ns + sample.upper_ns) // 2 + round(rate * (last_ns - sample.t3_ns)),
                sample.round_trip_ns,
            )
            for sample in self._samples
        )
        return NodeDetail(
            camera=self._name,
            samples=samples,
            phase_errors_ns=phase_errors_ns,
            log=tuple(self._lines),
            fps=vitals.fps,
            exposure_ns=vitals.exposure_ns,
            gain=vitals.gain,
            white_balance=None if newest is None else newest.white_balance,
            spool="" if spool is None else str(spool),
            disk_free_bytes=None if spool is None else free_bytes(spool),
        )
