"""Rolling-shutter image sensor in virtual time: whole rows, injected long frames, latency, noise, drops.

Inputs and outputs are true times in ns; all randomness comes from the generator passed in.
"""

import random
from dataclasses import dataclass, replace

from capture_app.common.camera_facts import PhaseControl
from capture_app.common.errors import CameraError
from capture_app.plugins.cameras.sim.profiles import SensorProfile

DELIVERY_NS = 5_000_000
"""Default delay from a frame's last row to the driver's callback."""


@dataclass(frozen=True, slots=True)
class SensorFrame:
    """One frame: its true times, and the timestamp that the driver would give it; ns of true time."""

    sequence: int
    """Number since the stream started; dropped frames count."""
    stream: int
    """Number of the start, from 0."""
    start_true_ns: int
    """Start of the first row's exposure."""
    timestamp_true_ns: int
    """Timestamp of the start: with noise, sometimes an outlier, and delayed by the device's bias."""
    readout_end_true_ns: int
    """End of the last row's readout: no driver can deliver the frame earlier."""
    exposure_ns: int
    dropped: bool
    """Whether the driver never delivers it; only the gap in the sequence shows."""


class Sensor:
    """One device: `next_frame` returns frames in order, commands change frames that it has not returned yet.

    The same generator state and the same calls give the same frames. `period_error_ppm` sets the error of
    this device's crystal; without it, the error is drawn from the profile's range.
    """

    def __init__(
        self, profile: SensorProfile, rng: random.Random, *, period_error_ppm: float | None = None
    ) -> None:
        self.profile = profile
        # Separate generators, so that a command changes neither the noise nor the drops of later frames.
        self._frame_rng = random.Random(rng.getrandbits(64))
        self._command_rng = random.Random(rng.getrandbits(64))
        self._start_rng = random.Random(rng.getrandbits(64))
        drawn_ppm = rng.uniform(-profile.period_error_ppm, profile.period_error_ppm)
        self.period_error_ppm = drawn_ppm if period_error_ppm is None else period_error_ppm
        self._error_ppb = round(self.period_error_ppm * 1000)
        self.streaming = False
        """Whether the sensor is streaming."""
        self.stream = -1
        """Number of the current or last stream; -1 before the first."""

    def start(self, true_ns: int) -> None:
        """Start a stream; its first frame comes after the start latency. Raises CameraError if one runs."""
        if self.streaming:
            raise CameraError("the simulated sensor streams already")
        mean_ns, sd_ns = self.profile.start_latency_ns
        self._stream_start_true_ns = true_ns + max(0, round(self._start_rng.gauss(mean_ns, sd_ns)))
        self.stream += 1
        self.streaming = True
        self._rows = self._sequence = 0
        self._late_ns = 0
        """Total shift of the stream by injections beyond whole rows."""
        self._delay_ns: dict[int, int] = {}
        self._exposure_rows: dict[int, int] = {}
        self._length_rows: dict[int, int] = {}

    def stop(self) -> None:
        """End the stream and discard pending commands. Calling it twice is harmless."""
        self.streaming = False

    def set_exposure(self, exposure_ns: int) -> None:
        """Set the exposure (ns) of later frames. Raises BadInputError if it does not fit a frame."""
        self.profile = replace(self.profile, exposure_ns=exposure_ns)

    def inject(self, exposure_ns: int, true_ns: int) -> None:
        """Give one coming frame this longer exposure; the command arrives at `true_ns`.

        The exposure is clamped to the profile's limits and truncated to whole rows. Commands take effect in
        order, one frame each. Raises CameraError if the sensor cannot inject or does not stream.
        """
        if self.profile.phase_control is not PhaseControl.INJECTION:
            raise CameraError(
                f"a simulated {self.profile.name} cannot inject frames", hint="restart its stream"
            )
        obeying = self._obeying(true_ns)
        self._exposure_rows[obeying] = self.profile.whole_rows(exposure_ns)
        typical_rows = self.profile.frame_length_rows
        if self.profile.injection_jitter_ns:
            self._delay_ns[obeying] = round(self._command_rng.gauss(0.0, self.profile.injection_jitter_ns))
        for sequence, stretch in enumerate(self.profile.stretches_rows(exposure_ns), obeying):
            self._length_rows[sequence] = max(
                typical_rows + stretch, self._length_rows.get(sequence, typical_rows)
            )

    def set_frame_duration(self, duration_ns: int, true_ns: int) -> None:
        """Set the duration of one coming frame; the command arrives at `true_ns`.

        The duration is clamped to the profile's limits and truncated to whole rows. Commands take effect in
        order, one frame each. Raises CameraError if the sensor cannot set durations or does not stream.
        """
        min_ns, max_ns = self.profile.frame_durations_ns
        if min_ns is None or max_ns is None:
            raise CameraError(f"the frame duration of a simulated {self.profile.name} cannot be set")
        rows = min(max(duration_ns, min_ns), max_ns) // self.profile.row_time_ns
        exposed = self.profile.exposure_ns // self.profile.row_time_ns + self.profile.margin_rows
        self._length_rows[self._obeying(true_ns)] = max(rows, exposed)

    def _obeying(self, true_ns: int) -> int:
        """Return the sequence number of the first frame that a command can change, arriving at `true_ns`.

        Raises CameraError if the sensor does not stream.
        """
        if not self.streaming:
            raise CameraError("the simulated sensor does not stream")
        latency = self._command_rng.randint(*self.profile.command_latency_frames)
        after_last = max(self._exposure_rows or self._length_rows, default=-1) + 1
        exposed = self._sequence + (true_ns - self._start_of(self._rows)) // self.profile.period_ns
        return max(exposed + latency, self._sequence, after_last)

    def next_frame(self) -> SensorFrame:
        """Return the stream's next frame, dropped or not. Raises CameraError if there is no stream."""
        if not self.streaming:
            raise CameraError("the simulated sensor does not stream")
        profile, rng, sequence = self.profile, self._frame_rng, self._sequence
        # Draw equally often for every frame, whatever the fractions, so that no frame affects another.
        noise_ns = rng.gauss(0.0, 1.0) * profile.timestamp_noise_ns
        late_ns = rng.random() * profile.outlier_ns
        outlier, dropped = rng.random() < profile.outlier_fraction, rng.random() < profile.drop_fraction
        start_true_ns = self._start_of(self._rows)
        rows = self._exposure_rows.pop(sequence, profile.exposure_ns // profile.row_time_ns)
        self._sequence += 1
        self._rows += self._length_rows.pop(sequence, profile.frame_length_rows)
        self._late_ns += self._delay_ns.pop(sequence, 0)
        exposure_ns = rows * profile.row_time_ns
        late_ns = (profile.stamp_bias_ns or 0) + (late_ns if outlier else 0.0)
        return SensorFrame(
            sequence=sequence,
            stream=self.stream,
            start_true_ns=start_true_ns,
            timestamp_true_ns=profile.stamp(start_true_ns + round(noise_ns + late_ns)),
            readout_end_true_ns=start_true_ns + exposure_ns + profile.image_rows * profile.row_time_ns,
            exposure_ns=exposure_ns,
            dropped=dropped,
        )

    def _start_of(self, rows: int) -> int:
        """Return the true start in ns of the frame `rows` into the stream; integers, so no errors add up."""
        nominal_ns = rows * self.profile.row_time_ns
        stretch_ns = nominal_ns * self._error_ppb // 10**9
        return self._stream_start_true_ns + nominal_ns + stretch_ns + self._late_ns
