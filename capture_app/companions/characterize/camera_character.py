"""Characterization of one camera: watch it, restart it repeatedly, and shift its phase by known commands."""

import asyncio
from collections import deque
from collections.abc import Sequence
from functools import partial
from math import ceil, e, log, pi, sqrt
from statistics import fmean, median

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from capture_app.cameras.base import Camera
from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import open_camera
from capture_app.common.camera_facts import CameraFacts, PhaseControl
from capture_app.common.clock import HostClock, NodeClock
from capture_app.common.errors import CameraError
from capture_app.common.tasks import has_come
from capture_app.common.text import Talk, count
from capture_app.common.timeouts import NO_FRAME_TIMEOUT_S
from capture_app.machine.cameras import modes_of
from capture_app.node.camera.device_profiles import DeviceProfiles, mode_key
from capture_app.sync.phase.actuators import InjectionProfile
from capture_app.sync.phase.estimator import FrameStamp, PhaseEstimator
from capture_app.sync.phase.injection import (
    FIRST_STRETCH_NS,
    INSIDE_ROW,
    InjectionActuator,
    InjectionHistory,
)
from capture_app.sync.wire.camera_commands import CameraCommand, InjectFrame, RestartStream, SetFrameDuration

PLACE_FRAMES = 40
"""Number of frames that determine the phase before and after a shift."""
OUTLIER = 4.0
"""Timestamps with a residual of more than this many times the noise are outliers."""
MIN_SHIFTS = 6
WIDEST_NS = 200_000.0
"""Maximum step: no sensor's row time is longer."""
FINEST = 2.0
"""Minimum step, in multiples of the noise."""
NORMAL = sqrt(2.0 * pi * e)
"""Width of uniform noise with the same entropy as normal noise of 1 sd, in sd."""
SURE = log(100.0)
"""Minimum log-likelihood advantage of a step over the best of as many false candidates."""
MOVES = 20
Offsets = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
STRETCHES_NS = tuple(37_000 * number + 1_900 * number**2 for number in range(MOVES))
"""Stretch of each frame beyond the first stretch; no two differences are equal."""
SETTLING_FRAMES = 40
"""Frames before anything is counted, because a stream that has just begun may stutter."""


class Moves(Struct, frozen=True, kw_only=True):
    """Effect of commands on the phase; times in ns, None where the stream did not show it."""

    commands: int
    effective: int
    """Number of commands that shifted the phase."""
    latency_frames: tuple[int, int] | None = None
    """Minimum and maximum number of frames from a command until the phase had shifted."""
    step_ns: float | None = None
    """Common divisor of all shifts: a row time, multiplied by the gain of an injection."""
    row_time_ns: float | None = None
    """Row time, from that step."""
    injection: InjectionProfile | None = None
    overhead_ns: float | None = None
    """Frame duration minus exposure, from the injections."""
    reason: str = ""
    """Why a value is unknown."""


class Starts(Struct, frozen=True, kw_only=True):
    """Start latencies, from the command to the first frame's timestamp, in ns."""

    latencies_ns: tuple[int, ...]
    by_restart: bool
    """Measured by restarts of the stream; otherwise by closing and reopening the camera."""


class Character(Struct, frozen=True, kw_only=True):
    """One camera in one mode; times in ns, by this machine's clock."""

    spec: str
    camera: CameraFacts
    modes: str
    """All modes of the camera, in its driver's words."""
    frames: int
    drops: int
    period_ns: float
    rate_error_ppm: float
    """Deviation from the nominal frame rate; positive if faster."""
    stamp_step_ns: float
    """Quantization step of the timestamps; 0 if it is too fine to matter."""
    stamp_jitter_ns: float
    """Standard deviation of the timestamps about the stream's fitted line."""
    delivery_ns: int
    """Median delay from a frame's timestamp to its arrival."""
    slowest_delivery_ns: int
    exposures_ns: tuple[int, int] | None = None
    """Minimum and maximum exposure of the watched frames; None if frames do not report it."""
    starts: Starts | None = None
    moves: Moves | None = None
    """None for a camera whose phase is shifted by restarts, or not at all."""
    saved: bool = False
    """Whether it is stored in this machine's profiles, so that nodes use it from their first command on."""


class StreamWatch:
    """One opened camera, from start to stop; times in ns of the clock of its timestamps."""

    def __init__(self, camera: Camera, clock: NodeClock) -> None:
        self.camera = camera
        self.phase = PhaseEstimator(period_ns=camera.facts.period_ns)
        self.seen_ns: list[tuple[int, int | None]] = []
        """Of each frame: delay from its timestamp to its arrival here, and its exposure."""
        self._clock = clock
        self._arrived = asyncio.Event()
        self._failure: Exception | None = None
        self._stream = -1
        self._stamps: deque[tuple[int, int]] = deque(maxlen=PLACE_FRAMES)
        """Numbers and timestamps of the newest frames."""

    async def start(self) -> int:
        """Start the stream; return the time from the command to the first frame's timestamp.

        Raises CameraError where the camera cannot start or delivers no frames.
        """
        begun_ns = self._clock.now_ns()
        await self.camera.start(self._add, self._fail)
        await self.frames(1)
        return self._first_stamp_ns - begun_ns

    async def restart(self, delay_ns: int) -> int:
        """Restart the stream; return the time from the command to its first frame's timestamp."""
        stream, begun_ns = self._stream, self._clock.now_ns() + delay_ns
        await self.camera.apply(RestartStream(delay_ns))
        while self._stream <= stream:
            await self._next()
        return self._first_stamp_ns - begun_ns

    async def shift(self, command: CameraCommand) -> tuple[float, int | None]:
        """Apply a command; return the phase shift and the frames until it took effect, None if it never did.

        The phase is measured over PLACE_FRAMES before the command, already received, and as many after it.
        """
        phase, sequence = self.phase, self._stamps[-1][0]
        before_ns = self._place(sequence)
        phase.mark_disturbance()
        await self.camera.apply(command)
        while phase.disturbed:
            await self._next()
        moved = phase.last_shift_ns is not None
        await self.frames(PLACE_FRAMES)
        return self._place(sequence) - before_ns, phase.last_latency_frames if moved else None

    def _place(self, sequence: int) -> float:
        """Return the time at which frame `sequence` would start, extrapolated from the newest frames."""
        places = [stamp_ns - self.phase.period_ns * (number - sequence) for number, stamp_ns in self._stamps]
        middle, noise_ns = median(places), max(self.phase.noise_ns, 1_000.0)
        return fmean(place for place in places if abs(place - middle) <= OUTLIER * noise_ns)

    async def frames(self, count: int) -> None:
        """Wait for `count` more frames."""
        target = self.phase.frames + count
        while self.phase.frames < target:
            await self._next()

    async def _next(self) -> None:
        """Wait for a frame. Raises CameraError if none arrives."""
        self._arrived.clear()
        if not await has_come(self._arrived, NO_FRAME_TIMEOUT_S):
            raise CameraError(
                f"the camera delivered no frames for {NO_FRAME_TIMEOUT_S:.0f} s",
                hint="check its cable, and close other programs that use it",
            )
        if self._failure is not None:
            raise CameraError(
                f"the camera failed: {self._failure}",
                hint="check its power and cable, and close other programs that use it",
            )

    def _add(self, frame: CapturedFrame) -> None:
        self.seen_ns.append((self._clock.now_ns() - frame.timestamp_ns, frame.exposure_ns))
        if frame.stream > self._stream:
            self._stream, self._first_stamp_ns = frame.stream, frame.timestamp_ns
        self._stamps.append((frame.sequence, frame.timestamp_ns))
        self.phase.add(FrameStamp(frame.sequence, frame.stream, frame.timestamp_ns))
        self._arrived.set()

    def _fail(self, error: Exception) -> None:
        self._failure = error
        self._arrived.set()


def common_step(shifts_ns: Sequence[float], noise_ns: float) -> float | None:
    """Return the step of which all shifts are most likely integer multiples, given the noise (1 sd) of each.

    None if no step is likely enough, as one hardly wider than the noise, or if there are too few shifts.
    """
    # No timestamps are better than 500 ns, and finer steps would take long to distinguish.
    noise_ns = max(noise_ns, 500.0)
    if len(shifts_ns) < MIN_SHIFTS or FINEST * noise_ns >= WIDEST_NS:
        return None
    # Differences from the minimum are smaller, so fewer candidates distinguish their multiples.
    offs = np.asarray(shifts_ns) - min(shifts_ns)
    ratio = 1.0 - noise_ns / max(offs.max(), noise_ns) / 2.0
    steps_ns = WIDEST_NS * ratio ** np.arange(ceil(log(FINEST * noise_ns / WIDEST_NS) / log(ratio)))
    # In parts, as there are up to a million candidates.
    parts = np.array_split(steps_ns, ceil(len(steps_ns) / 10_000))
    residuals_ns = np.concatenate([_residuals(offs, part) for part in parts])
    likely = np.log(steps_ns / np.maximum(residuals_ns, noise_ns / 2.0))
    advantage = (len(offs) - 2) * (likely.max() - log(NORMAL))
    return _refined(offs, steps_ns[likely.argmax()]) if advantage >= SURE + log(len(steps_ns)) else None


def _residuals(offs_ns: Offsets, steps_ns: Offsets) -> Offsets:
    """Return the residual (1 sd) from the best lattice of each step, each at most half a step from it.

    The offset of a lattice is fitted, as the minimum has noise, too.
    """
    steps_ns = steps_ns[:, np.newaxis]
    first = offs_ns - steps_ns * np.round(offs_ns / steps_ns)
    centered = offs_ns - first.mean(axis=1, keepdims=True)
    left = centered - steps_ns * np.round(centered / steps_ns)
    return np.asarray(np.sqrt((left**2).mean(axis=1)))


def _refined(offs_ns: Offsets, step_ns: float) -> float:
    """Return the slope of a line through the shifts, once the number of steps of each is known."""
    counts = np.round(offs_ns / step_ns)
    return float(np.polyfit(counts, offs_ns, 1)[0]) if counts.any() else step_ns


async def measure_moves(watch: StreamWatch, facts: CameraFacts, moves: int) -> Moves:
    """Apply up to `moves` commands to a camera that has them, and measure their effect.

    Raises CameraError where the camera refuses one, or stops delivering frames.
    """
    by_injection = facts.phase_control is PhaseControl.INJECTION
    if by_injection and (problem := InjectionActuator(facts).problem):
        return Moves(commands=0, effective=0, reason=problem)
    history = InjectionHistory(period_ns=facts.period_ns, row_time_ns=facts.row_time_ns)
    shifts_ns: list[float] = []
    latencies: list[int] = []
    for number, stretch_ns in enumerate(STRETCHES_NS[:moves]):
        command, rows = _command(facts, number, stretch_ns, history)
        shift_ns, latency = await watch.shift(command)
        if latency is not None:
            shifts_ns.append(shift_ns)
            latencies.append(latency)
            history.add(rows, shift_ns / history.row_ns, watch.phase.noise_ns / history.row_ns)
    step_ns = common_step(shifts_ns, watch.phase.noise_ns * sqrt(2.0 / PLACE_FRAMES))
    profile = history.fit() if by_injection and history.moved else None
    gain = 1.0 if profile is None else profile.gain
    return Moves(
        commands=moves,
        effective=len(shifts_ns),
        latency_frames=(min(latencies), max(latencies)) if latencies else None,
        step_ns=step_ns,
        row_time_ns=None if step_ns is None else step_ns / gain,
        injection=profile,
        overhead_ns=facts.period_ns - profile.neutral_rows * profile.row_time_ns if profile else None,
        reason=_reason(len(shifts_ns), step_ns),
    )


def _command(
    facts: CameraFacts, number: int, stretch_ns: int, history: InjectionHistory
) -> tuple[CameraCommand, int]:
    """Return a command that lengthens one frame, and the number of rows that it is exposed, or lasts, for."""
    rows = round((facts.period_ns + FIRST_STRETCH_NS + stretch_ns) / history.row_ns)
    # Alternate even and odd row counts: even counts alone would look like rows of twice the length.
    rows += (rows + number) % 2
    asked_ns = round((rows + INSIDE_ROW) * history.row_ns)
    if facts.phase_control is PhaseControl.INJECTION:
        return InjectFrame(min(asked_ns, facts.max_exposure_ns or asked_ns)), rows
    return SetFrameDuration(min(asked_ns, facts.max_frame_duration_ns or asked_ns)), rows


def _reason(effective: int, step_ns: float | None) -> str:
    if not effective:
        return "no command moved its phase"
    if effective < MIN_SHIFTS:
        return f"too few moves to measure the row time: {MIN_SHIFTS} are needed"
    return "" if step_ns is not None else "its timestamps scatter too much to measure the row time"


async def characterize(
    spec: str,
    *,
    seconds: float,
    starts: int,
    moves: int = MOVES,
    keep: bool,
    talk: Talk,
    clock: NodeClock | None = None,
) -> Character:
    """Measure a camera of this machine, and with `keep` save what nodes use to this user's profiles.

    It is watched for `seconds`, started `starts` times, and shifted `moves` times; its timestamps are in
    `clock`, by default the host's. Raises BadInputError for an unusable spec, CameraError where it cannot be
    opened or delivers no frames.
    """
    clock = clock or HostClock()
    reopen = partial(open_camera, spec, clock=clock, name="characterize")
    watch = StreamWatch(reopen(), clock)
    latencies_ns: list[int] = []
    try:
        talk("starting")
        await watch.start()
        # Some facts are known only once the camera streams.
        facts = watch.camera.facts
        await watch.frames(SETTLING_FRAMES)
        watch.seen_ns.clear()
        target = max(SETTLING_FRAMES, round(seconds * 1e9 / facts.period_ns))
        talk(f"watching {count(target, 'frame')}")
        await watch.frames(target)
        phase, deliveries_ns = watch.phase, [delivery_ns for delivery_ns, _ in watch.seen_ns]
        exposures_ns = [exposure_ns for _, exposure_ns in watch.seen_ns if exposure_ns is not None]
        character = Character(
            spec=spec,
            camera=facts,
            modes=modes_of(spec),
            frames=phase.frames,
            drops=phase.drops,
            period_ns=phase.period_ns,
            rate_error_ppm=(facts.period_ns / phase.period_ns - 1.0) * 1e6,
            stamp_step_ns=phase.quantum_ns,
            stamp_jitter_ns=phase.noise_ns,
            delivery_ns=round(median(deliveries_ns)),
            slowest_delivery_ns=max(deliveries_ns),
            exposures_ns=(min(exposures_ns), max(exposures_ns)) if exposures_ns else None,
        )
        if moves and facts.phase_control in (PhaseControl.INJECTION, PhaseControl.FRAME_DURATION):
            talk(f"moving its phase {count(moves, 'time')}")
            character = replace(character, moves=await measure_moves(watch, facts, moves))
        by_restart = facts.phase_control is PhaseControl.RESET
        talk(f"starting it {count(starts, 'time')}")
        for number in range(starts):
            if by_restart:
                # Multiples of this fraction of the period cover it evenly for any number of restarts.
                latencies_ns.append(await watch.restart(round(number * 0.618 % 1.0 * facts.period_ns)))
            else:
                await watch.camera.stop()
                watch = StreamWatch(reopen(), clock)
                latencies_ns.append(await watch.start())
            await watch.frames(12)
    finally:
        await watch.camera.stop()
    if latencies_ns:
        taken = Starts(latencies_ns=tuple(latencies_ns), by_restart=by_restart)
        character = replace(character, starts=taken)
    return save(character, DeviceProfiles()) if keep else character


def save(character: Character, profiles: DeviceProfiles) -> Character:
    """Save to this machine's profiles what nodes use; return the character, with whether it was saved."""
    saved, moves, starts = False, character.moves, character.starts
    if moves is not None and moves.injection is not None:
        saved = profiles.save(mode_key(character.camera), injection=moves.injection)
    if starts is not None and starts.by_restart:
        shares_ns = tuple(round(latency % character.period_ns) for latency in starts.latencies_ns)
        saved = profiles.save(mode_key(character.camera), start_latencies_ns=shares_ns)
    return replace(character, saved=saved)
