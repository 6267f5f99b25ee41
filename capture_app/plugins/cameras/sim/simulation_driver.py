"""Simulated cameras in real time: opened by a spec, they deliver a virtual sensor's frames as real ones do.

Images and ground truth are rendered when they are saved.
"""

import asyncio
import dataclasses
import hashlib
import io
import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from msgspec import structs

from capture_app.cameras.base import Camera, OnFailure, OnFrame
from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import read_number
from capture_app.common.camera_facts import (
    KELVIN,
    MICROSECONDS,
    SIMULATED,
    TIMES,
    CameraListing,
    Control,
    ControlState,
)
from capture_app.common.clock import NodeClock
from capture_app.common.errors import BadInputError, CameraError
from capture_app.common.plugins import plugin_names
from capture_app.plugins.cameras.sim.profiles import PROFILES, SensorProfile, facts_of, find_profile
from capture_app.plugins.cameras.sim.rendering.picture_source import (
    TEST_CARD,
    VIEWS,
    PictureSource,
    open_picture_source,
)
from capture_app.plugins.cameras.sim.sensor import Sensor, SensorFrame
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.reading.decoding import JPEG_QUALITY, encode_image
from capture_app.sync.wire.camera_commands import CameraCommand, InjectFrame, SetFrameDuration

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MAX_GAIN = 16.0
CHOSEN_KELVIN = 5000.0
WANDER, WANDER_NS = 0.3, 10_000_000_000
"""Amplitude, as a fraction, and period of the automatic exposure's variation, as under clouds."""
DEPTH_STEPS_PER_M = 2048
DELIVERY_NS = (2_000_000, 4_000_000)
"""Min and max delay from the end of a frame's readout to its callback."""
STALL_NS = 500_000_000
"""A driver has few buffers: frames that are not fetched within this time are dropped."""
SPEC = f"{SIMULATED}:PROFILE[,scene=NAME][,view=NAME][,key=value…]"
HELP = "Simulated cameras of a phone, a Raspberry Pi or a webcam, that see a rendered scene."
NEEDS = ""
_SCENES = ", ".join(["a scene's name", *plugin_names(VIEWS)])
OPTIONS = {
    "scene": f"what it sees: {_SCENES}, or {TEST_CARD}, a test card (default)",
    "view": "the scene's view; default: the one named like the node",
    "scale": "size of the pictures, 0.1 to 1 of the full size",
    "samples": "rays of each pixel of a scene, 1 to 4 (default): fewer are quicker and rougher",
    "calibration": "none: sessions do not get the scene's true calibration",
    "seed": "any word; with the node's name it chooses crystal, noise and drops",
    "exposure_ms": "exposure of every frame",
    "auto": "exposure: the camera chooses the exposure, which varies slightly, until it is set",
    "ppm": "error of this device's crystal",
    "noise_us": "standard deviation of the timestamps",
    "stamp_bias_ms": "all timestamps are late by this, and the camera does not know it, as no real one does",
    "outliers": "fraction of timestamps that are late, 0 to 1",
    "drops": "fraction of frames that never arrive, 0 to 1",
    "start_ms": "time from the start command to the first frame, without its scatter",
    "fail_after_s": "the camera goes away this long after its start",
}
_CAMERA = "a simulated camera"
_CHANGES: dict[str, tuple[float, Callable[[float], dict[str, Any]]]] = {
    "exposure_ms": (1e3, lambda ms: {"exposure_ns": round(ms * 1e6)}),
    "noise_us": (1e4, lambda us: {"timestamp_noise_ns": round(us * 1e3)}),
    "stamp_bias_ms": (100, lambda ms: {"stamp_bias_ns": round(ms * 1e6)}),
    "outliers": (1, lambda fraction: {"outlier_fraction": fraction}),
    "drops": (1, lambda fraction: {"drop_fraction": fraction}),
    "start_ms": (1e4, lambda ms: {"start_latency_ns": (round(ms * 1e6), 0)}),
}
"""Max value of an option, whose min is 0, and the change that it makes to the profile."""


class SimulatedControls:
    """A simulated camera's controls within its profile; gain and white balance change no image."""

    def __init__(self, profile: SensorProfile, *, automatic: bool) -> None:
        self._profile = profile
        self._held_ns = self._chosen_ns = self._whole(profile.exposure_ns)
        self.automatic = automatic
        """Whether the camera chooses its exposure."""
        self.gain = 1.0
        self._white_balance_k: float | None = CHOSEN_KELVIN

    @property
    def exposure_ns(self) -> int:
        """Exposure of the next frames, in whole rows."""
        return self._chosen_ns if self.automatic else self._held_ns

    def let_time_pass(self, true_ns: int) -> bool:
        """Update an automatic exposure; return whether it has changed."""
        if not self.automatic:
            return False
        before_ns, angle = self._chosen_ns, 2.0 * math.pi * (true_ns % WANDER_NS) / WANDER_NS
        self._chosen_ns = self._whole((1.0 + WANDER * math.sin(angle)) * self._profile.exposure_ns)
        return self._chosen_ns != before_ns

    def states(self) -> tuple[ControlState, ...]:
        """Return all controls with their current values."""
        return (
            ControlState(
                control=Control.EXPOSURE,
                value=self.exposure_ns / 1000,
                unit=MICROSECONDS,
                automatic=self.automatic,
                can_be_automatic=True,
                minimum=self._whole(0) / 1000,
                maximum=self._whole(self._profile.period_ns) / 1000,
            ),
            ControlState(control=Control.GAIN, value=self.gain, unit=TIMES, minimum=1.0, maximum=MAX_GAIN),
            ControlState(
                control=Control.WHITE_BALANCE,
                value=self._white_balance_k or CHOSEN_KELVIN,
                unit=KELVIN,
                automatic=self._white_balance_k is None,
                can_be_automatic=True,
                minimum=2000.0,
                maximum=10_000.0,
            ),
        )

    def set(self, control: Control, value: float | None) -> None:
        """Set a control, within its limits; None lets the camera choose."""
        if control is Control.EXPOSURE:
            self.automatic = value is None
            if value is not None:
                self._held_ns = self._whole(value * 1000)
        elif control is Control.WHITE_BALANCE:
            self._white_balance_k = value
        elif value is not None:
            self.gain = value

    def _whole(self, exposure_ns: float) -> int:
        """Return the exposure in whole rows, limited so that it stretches no frame."""
        rows = self._profile.whole_rows(round(exposure_ns))
        min_rows = -(-self._profile.min_exposure_ns // self._profile.row_time_ns)
        return max(min_rows, min(rows, self._profile.neutral_rows)) * self._profile.row_time_ns


@dataclass(frozen=True, slots=True)
class SimulatedPicture:
    """An image that is rendered when it is saved."""

    source: PictureSource
    frame: SensorFrame
    seed: int
    quality: int = JPEG_QUALITY

    @property
    def held_bytes(self) -> int:
        """Memory that the image takes, in bytes: 0 before it is rendered."""
        return 0

    def encode(self) -> bytes:
        """Render the frame and return it as JPEG bytes; the same frame gives the same bytes."""
        return encode_image(self.source.render(self.frame, seed=self.seed), quality=self.quality)

    def reduced(self, width: int) -> "NDArray[np.uint8]":
        """Render the frame at about `width` px, simplified if that is faster: BGR uint8 (H, W, 3)."""
        return self.source.reduced(self.frame, width, seed=self.seed)


def encode_truth(source: PictureSource, frame: SensorFrame) -> bytes:
    """Return an .npz with `depth_m` (float32 HxW, 0 = none), `objects` (uint8), `movers` (bool) of a frame.

    Depth is rounded to 1/2048 m: a quarter of a millimetre of error for a fifth of the bytes.
    """
    import numpy as np

    exact_m, objects, movers = source.ground_truth(frame)
    depth_m = np.rint(exact_m * DEPTH_STEPS_PER_M) / np.float32(DEPTH_STEPS_PER_M)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, depth_m=depth_m, objects=objects, movers=movers)
    return buffer.getvalue()


def stable_seed(text: str) -> int:
    """Return a seed, 0 to 2**63 - 1, that is the same for the same text in every run."""
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest()) >> 1


class SimulatedCamera(Camera):
    """A virtual sensor on the event loop: one timer, set to the next frame's delivery."""

    def __init__(
        self,
        sensor: Sensor,
        source: PictureSource,
        clock: NodeClock,
        *,
        seed: int,
        fail_after_s: float | None = None,
        calibrated: bool = True,
        automatic: bool = False,
    ) -> None:
        """Create a camera with its own `seed`; the device disconnects `fail_after_s` after its start.

        `automatic`: it chooses its exposure itself, until that is set.
        `calibrated`: it reports the view's true calibration, as no real camera does.
        """
        self._sensor, self._source, self._calibrated = sensor, source, calibrated
        self._clock, self._seed, self._delivery_rng = clock, seed, random.Random(seed)
        self._fail_after_s = fail_after_s
        self._started = False
        self._timer: asyncio.TimerHandle | None = None
        self._restarting: asyncio.Future[None] | None = None
        self._controls = SimulatedControls(sensor.profile, automatic=automatic)
        self._facts = facts_of(sensor.profile, width=source.width, height=source.height)
        if automatic:
            self._expose()

    @property
    def calibration(self) -> CameraCalibration | None:
        """Calibration of the rendered view; None for the test card."""
        return self._source.calibration if self._calibrated else None

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Start streaming. Raises CameraError if it is already streaming."""
        if self._started:
            raise CameraError(f"the {self.facts.model} streams already")
        self._started = True
        self._on_frame, self._on_failure = on_frame, on_failure
        true_ns = self._true_now_ns()
        self._fail_at_true_ns = (
            None if self._fail_after_s is None else true_ns + round(self._fail_after_s * 1e9)
        )
        self._start_stream(true_ns)

    async def apply(self, command: CameraCommand) -> None:
        """Change a coming frame; or stop the stream, and return when it is due to start again.

        The restart's delay counts from this call. Raises CameraError if the camera does not stream or
        cannot follow the command.
        """
        if not self._started:
            raise CameraError(f"the {self.facts.model} does not stream")
        true_ns = self._true_now_ns()
        if isinstance(command, InjectFrame):
            self._sensor.inject(command.exposure_ns, true_ns)
        elif isinstance(command, SetFrameDuration):
            self._sensor.set_frame_duration(command.duration_ns, true_ns)
        else:
            self._sensor.stop()
            self._cancel()
            loop, start_ns = asyncio.get_running_loop(), true_ns + command.delay_ns
            self._restarting = loop.create_future()
            self._timer = loop.call_later(command.delay_ns / 1e9, self._start_stream, start_ns)
            await self._restarting

    async def controls(self) -> tuple[ControlState, ...]:
        """Return exposure, gain and white balance."""
        return self._controls.states()

    async def set_control(self, control: Control, value: float | None) -> None:
        """Set a control from the next frame on. Raises CameraError if it cannot be set."""
        self._controls.set(control, value)
        self._expose()

    def _expose(self) -> None:
        """Apply the controls' exposure to the next frames."""
        self._sensor.set_exposure(self._controls.exposure_ns)
        exposure_ns = None if self._controls.automatic else self._controls.exposure_ns
        self._facts = structs.replace(self.facts, exposure_ns=exposure_ns)

    async def stop(self) -> None:
        """Stop streaming. Calling it twice is harmless."""
        self._halt()

    def _start_stream(self, true_ns: int) -> None:
        """Start the sensor at the requested instant: a delay of the event loop is not the camera's."""
        self._end_restart()
        self._sensor.start(true_ns)
        self._await_next()

    def _await_next(self) -> None:
        """Take the next frame from the sensor and set the timer to its delivery."""
        if self._controls.let_time_pass(self._true_now_ns()):
            self._expose()
        frame = self._sensor.next_frame()
        due_true_ns = frame.readout_end_true_ns + self._delivery_rng.randint(*DELIVERY_NS)
        delay_s = max(0, due_true_ns - self._true_now_ns()) / 1e9
        self._timer = asyncio.get_running_loop().call_later(delay_s, self._deliver, frame, due_true_ns)

    def _deliver(self, frame: SensorFrame, due_true_ns: int) -> None:
        now_true_ns = self._true_now_ns()
        if self._fail_at_true_ns is not None and now_true_ns >= self._fail_at_true_ns:
            self._halt()
            self._on_failure(
                CameraError(f"the {self.facts.model} went away", hint="as its option fail_after_s asks")
            )
            return
        # Set the next timer first, because the callback may stop the camera.
        self._await_next()
        if not frame.dropped and now_true_ns - due_true_ns < STALL_NS:
            self._on_frame(self._captured(frame))

    def _captured(self, frame: SensorFrame) -> CapturedFrame:
        # The same frame gets the same noise in every run.
        seed = stable_seed(f"{self._seed}/{frame.stream}/{frame.sequence}")
        return CapturedFrame(
            sequence=frame.sequence,
            stream=frame.stream,
            timestamp_ns=self._clock.local_from_true(frame.timestamp_true_ns),
            picture=SimulatedPicture(self._source, frame, seed),
            exposure_ns=frame.exposure_ns,
            gain=self._controls.gain,
            white_balance=(1.0, 1.0),
            true_ns=frame.start_true_ns,
            encode_truth=partial(encode_truth, self._source, frame),
        )

    def _true_now_ns(self) -> int:
        return self._clock.true_from_local(self._clock.now_ns())

    def _cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._end_restart()

    def _end_restart(self) -> None:
        if self._restarting is not None and not self._restarting.done():
            self._restarting.set_result(None)

    def _halt(self) -> None:
        self._cancel()
        self._sensor.stop()
        self._started = False


def list_cameras() -> list[CameraListing]:
    """Return the simulated models."""
    return [
        CameraListing(
            spec=f"sim:{profile.name}",
            kind=SIMULATED,
            model=profile.model,
            detail=f"{profile.image_width}x{profile.image_rows} at {1e9 / profile.period_ns:.0f} frames/s, "
            f"moves its phase by {profile.phase_control}",
        )
        for profile in PROFILES.values()
    ]


def open_camera(profile: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> SimulatedCamera:
    """Open a simulated camera of a model of `simulation.profiles` for the node `name`; see OPTIONS.

    Raises BadInputError for an unknown profile, scene, view, option or value, and NotAvailableError if
    this machine cannot render scenes.
    """
    model = _adjusted(find_profile(profile), options)
    camera_seed = stable_seed(f"{name}/{options.get('seed', '0')}")
    source = open_picture_source(
        options.get("scene", TEST_CARD),
        options.get("view", ""),
        camera=name,
        width=model.image_width,
        height=model.image_rows,
        row_time_ns=model.row_time_ns,
        scale=read_number(options, "scale", _CAMERA, low=0.1, high=1) or 1.0,
        samples=int(read_number(options, "samples", _CAMERA, low=1, high=4) or 4),
    )
    sensor = Sensor(
        dataclasses.replace(model, image_rows=source.height),
        random.Random(camera_seed),
        period_error_ppm=read_number(options, "ppm", _CAMERA, low=-1000, high=1000),
    )
    return SimulatedCamera(
        sensor,
        source,
        clock,
        seed=camera_seed,
        fail_after_s=read_number(options, "fail_after_s", _CAMERA, low=0, high=1e6),
        calibrated=not _says(options, "calibration", "none", otherwise="true"),
        automatic=_says(options, "auto", "exposure"),
    )


def _adjusted(profile: SensorProfile, options: Mapping[str, str]) -> SensorProfile:
    """Return the profile with the options' changes; the profile validates the exposure."""
    for key, (max_value, change) in _CHANGES.items():
        value = read_number(options, key, _CAMERA, low=0, high=max_value)
        if value is not None:
            profile = dataclasses.replace(profile, **change(value))
    return profile


def _says(options: Mapping[str, str], key: str, value: str, *, otherwise: str = "") -> bool:
    """Return whether an option is `value`; its only other valid value is `otherwise`."""
    text = options.get(key, otherwise)
    if text not in (value, otherwise):
        raise BadInputError(f"{key}={text} of a simulated camera", hint=f"{value}, or leave it out")
    return text == value
