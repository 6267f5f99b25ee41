"""A simulated camera in real time: the virtual sensor's frames, delivered when a real driver would."""

import asyncio
import random

from msgspec.structs import replace

from capture_app.camera_controls import Control, ControlState
from capture_app.camera_facts import CameraFacts
from capture_app.cameras.base import Camera, CapturedFrame, OnFailure, OnFrame
from capture_app.cameras.v4l2.pictures import JpegPicture
from capture_app.clock import NodeClock
from capture_app.errors import CameraError
from capture_app.session.format.calibration import CameraCalibration
from capture_app.simulation.camera.controls import SimulatedControls
from capture_app.simulation.camera.pictures import SimulatedPicture, SimulatedTruth, frame_seed
from capture_app.simulation.devices.profiles import facts_of
from capture_app.simulation.devices.sensor import Sensor, SensorFrame
from capture_app.simulation.rendering.picture_source import PictureSource
from capture_app.sync.wire.camera_commands import CameraCommand, InjectFrame, SetFrameDuration

DELIVERY_NS = (2_000_000, 4_000_000)
"""Least and most time from the end of a frame's readout to its callback."""
STALL_NS = 500_000_000
"""A driver has few buffers: frames that are not fetched for this long are dropped."""


class SimulatedCamera(Camera):
    """A virtual sensor on the event loop: one timer, set to the next frame's delivery."""

    def __init__(
        self,
        sensor: Sensor,
        source: PictureSource,
        clock: NodeClock,
        *,
        seed: int,
        fail_after_ns: int | None = None,
        calibrated: bool = True,
        automatic: bool = False,
    ) -> None:
        """`seed` is this camera's own; `fail_after_ns` after its start the device goes away.

        `automatic`: it chooses its exposure itself, until that is set.
        `calibrated`: it tells the view's true calibration, as no real camera does.
        """
        self._calibrated = calibrated
        self._sensor = sensor
        self._source = source
        self._clock = clock
        self._seed = seed
        self._fail_after_ns = fail_after_ns
        self._fail_at_true_ns: int | None = None
        self._delivery_rng = random.Random(seed)
        self._on_frame: OnFrame | None = None
        self._on_failure: OnFailure | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._restarting: asyncio.Future[None] | None = None
        self._controls = SimulatedControls(sensor.profile, automatic=automatic)
        self._facts = facts_of(sensor.profile, width=source.width, height=source.height)
        if automatic:
            self._expose()

    @property
    def facts(self) -> CameraFacts:
        """What this camera is and can do."""
        return self._facts

    @property
    def calibration(self) -> CameraCalibration | None:
        """The rendered view's own; None for the test card."""
        return self._source.calibration if self._calibrated else None

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Start streaming. Raises CameraError if it streams already."""
        if self._on_frame is not None:
            raise CameraError(f"the {self._facts.model} streams already")
        self._on_frame, self._on_failure = on_frame, on_failure
        true_ns = self._true_now_ns()
        self._fail_at_true_ns = None if self._fail_after_ns is None else true_ns + self._fail_after_ns
        self._start_stream(true_ns)

    async def apply(self, command: CameraCommand) -> None:
        """Change a coming frame at once; or stop now, and return when the stream is told to start again.

        The restart's delay counts from this call. Raises CameraError where the camera does not stream or
        cannot do that.
        """
        if self._on_frame is None:
            raise CameraError(f"the {self._facts.model} does not stream")
        true_ns = self._true_now_ns()
        if isinstance(command, InjectFrame):
            self._sensor.inject(command.exposure_ns, true_ns)
            return
        if isinstance(command, SetFrameDuration):
            self._sensor.set_frame_duration(command.duration_ns, true_ns)
            return
        self._sensor.stop()
        self._cancel()
        loop = asyncio.get_running_loop()
        self._restarting = loop.create_future()
        self._timer = loop.call_later(command.delay_ns / 1e9, self._start_stream, true_ns + command.delay_ns)
        await self._restarting

    async def controls(self) -> tuple[ControlState, ...]:
        """Exposure and gain."""
        return self._controls.states()

    async def set_control(self, control: Control, value: float | None) -> None:
        """Set one of them from the next frame on. Raises CameraError where it cannot."""
        self._controls.set(control, value)
        self._expose()

    def _expose(self) -> None:
        """Let the frames to come be exposed as the controls say."""
        self._sensor.set_exposure(self._controls.exposure_ns)
        exposure_ns = None if self._controls.automatic else self._controls.exposure_ns
        self._facts = replace(self._facts, exposure_ns=exposure_ns)

    async def stop(self) -> None:
        """Stop streaming. Calling it twice is harmless."""
        self._halt()

    def _start_stream(self, true_ns: int) -> None:
        """Start the sensor at the instant asked for: the event loop's lateness is not the camera's."""
        self._end_restart()
        self._sensor.start(true_ns)
        self._await_next()

    def _await_next(self) -> None:
        """Take the next frame from the sensor and set the timer to its delivery."""
        if self._controls.let_time_pass(self._true_now_ns()):
            self._expose()
        frame = self._sensor.next_frame()
        due_true_ns = frame.readout_end_true_ns + self._delivery_rng.randint(*DELIVERY_NS)
        delay_ns = max(0, due_true_ns - self._true_now_ns())
        self._timer = asyncio.get_running_loop().call_later(delay_ns / 1e9, self._deliver, frame, due_true_ns)

    def _deliver(self, frame: SensorFrame, due_true_ns: int) -> None:
        now_true_ns = self._true_now_ns()
        if self._fail_at_true_ns is not None and now_true_ns >= self._fail_at_true_ns:
            on_failure = self._on_failure
            self._halt()
            if on_failure is not None:
                on_failure(
                    CameraError(f"the {self._facts.model} went away", hint="as its option fail_after_s asks")
                )
            return
        # The next timer first: the callback may stop the camera.
        on_frame = self._on_frame
        self._await_next()
        fetched = not frame.dropped and now_true_ns - due_true_ns < STALL_NS
        if fetched and on_frame is not None:
            on_frame(self._captured(frame))

    def _captured(self, frame: SensorFrame) -> CapturedFrame:
        jpeg = self._source.jpeg(frame)
        seed = frame_seed(self._seed, frame.stream, frame.sequence)
        return CapturedFrame(
            sequence=frame.sequence,
            stream=frame.stream,
            timestamp_ns=self._clock.local_from_true(frame.timestamp_true_ns),
            picture=SimulatedPicture(self._source, frame, seed) if jpeg is None else JpegPicture(jpeg),
            exposure_ns=frame.exposure_ns,
            gain=self._controls.gain,
            white_balance=(1.0, 1.0),
            truth=SimulatedTruth(self._source, frame),
        )

    def _true_now_ns(self) -> int:
        return self._clock.true_from_local(self._clock.now_ns())

    def _cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._end_restart()

    def _end_restart(self) -> None:
        if self._restarting is not None and not self._restarting.done():
            self._restarting.set_result(None)
        self._restarting = None

    def _halt(self) -> None:
        self._cancel()
        self._sensor.stop()
        self._on_frame = self._on_failure = None
