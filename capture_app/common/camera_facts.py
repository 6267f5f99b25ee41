"""Camera properties, capabilities and controls, as structs for drivers, messages and sessions."""

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Annotated, Literal

from msgspec import Meta, Struct, ValidationError, convert, field

from capture_app.common.bounds import Count, Pixels, Positive, Real, RowTimeNs, Sentence, Text
from capture_app.common.errors import BadInputError
from capture_app.common.names import Label
from capture_app.common.text import count, duration

SIMULATED, PHONE = "sim", "phone"
"""Kinds of a simulated camera and of a phone."""
MAX_STAMP_NS = 10_000_000_000
"""Maximum bias of a timestamp, and of its uncertainty."""
DELIVERY_NS = 5_000_000
"""Assumed maximum delay between a frame's readout and the driver's timestamp."""
MICROSECONDS, TIMES, KELVIN, DIOPTRES = "µs", "×", "K", "dpt"
"""Units that are comparable between all cameras: exposure, gain, white balance, focus."""


class CameraListing(Struct, frozen=True):
    """Camera of this machine: its spec and its description; if unusable, the reason."""

    spec: str
    kind: str
    model: str
    detail: str
    usable: bool = True


class TimestampSource(StrEnum):
    """Moment of a frame that the driver's timestamp refers to."""

    START_OF_EXPOSURE = "start-of-exposure"
    END_OF_FRAME = "end-of-frame"
    UNKNOWN = "unknown"


class PhaseControl(StrEnum):
    """Method by which the phase of a stream can be moved."""

    FRAME_DURATION = "frame-duration"
    INJECTION = "injection"
    RESET = "reset"
    NONE = "none"


class StampSource(StrEnum):
    """Source of the knowledge of a camera's timestamp bias."""

    CONSTRUCTION = "construction"
    """Simulated camera, whose timestamps are correct by construction."""
    DRIVER = "driver"
    """Reported by a trustworthy driver."""
    PROFILE = "profile"
    """Known for cameras of this kind."""
    MOTION = "motion"
    """Measured from motion in its images and in other cameras' images."""
    LIGHT = "light"
    """Measured with a blinking light."""
    ASSUMED = "assumed"
    """Assumed: only that the timestamp follows the exposure, and not long after readout."""


_OF_THE_STAMP_ITSELF = {StampSource.DRIVER, StampSource.PROFILE, StampSource.MOTION, StampSource.LIGHT}
UNMEASURED = (StampSource.ASSUMED, StampSource.PROFILE)
REMEDY = "capture-app cameras calibrate-time"
"""Command that measures the timestamp delay."""
_SOURCES = {
    StampSource.CONSTRUCTION: "by construction",
    StampSource.DRIVER: "by its driver",
    StampSource.PROFILE: "by what is known of its kind",
    StampSource.MOTION: "measured by motion",
    StampSource.LIGHT: "measured by light",
    StampSource.ASSUMED: "assumed",
}


class StampAccuracy(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Timestamp bias of a camera, and its uncertainty; times in ns."""

    bias_ns: Annotated[int, Meta(ge=-MAX_STAMP_NS, le=MAX_STAMP_NS)]
    """Start of the first row's exposure by the timestamp and its `TimestampSource`, minus the true start.

    If the moment of the timestamp, or a correction of it, is unknown: the timestamp itself minus the true
    start.
    """
    uncertainty_ns: Annotated[int, Meta(ge=0, le=MAX_STAMP_NS)]
    """95 % uncertainty of the bias."""
    source: StampSource
    exposure_ns: Count | None = None
    """Exposure for which the bias is valid; None if it is valid for any, or if that is unknown."""
    against: Text = ""
    """Reference camera of the measurement, if its own bias is unknown; empty otherwise."""
    against_uncertainty_ns: Annotated[int, Meta(ge=0, le=MAX_STAMP_NS)] | None = None
    """95 % uncertainty of the reference camera's assumed bias; not in `uncertainty_ns`, as it cancels between
    the cameras that share it."""

    @property
    def is_exact(self) -> bool:
        """Whether the timestamps add no error at all, as only in a simulation."""
        return self.source is StampSource.CONSTRUCTION and self.uncertainty_ns == 0


EXACT_STAMPS = StampAccuracy(bias_ns=0, uncertainty_ns=0, source=StampSource.CONSTRUCTION)


class CameraFacts(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Properties and capabilities of a camera, fixed while it streams; times in ns, None while unknown."""

    kind: Text
    """Driver, such as v4l2 or sim; imported for a recording; clock or relay without a camera."""
    model: Text
    width: Pixels
    """Width in pixels, as the height; 0 for a node without a camera."""
    height: Pixels
    period_ns: Positive
    timestamp_source: TimestampSource
    phase_control: PhaseControl
    pixel_format: Text = ""
    """Format in which the driver delivers images, such as MJPG; empty if unknown."""
    row_time_ns: RowTimeNs | None = None
    """Readout time of one row."""
    exposure_ns: Count | None = None
    min_exposure_ns: Count | None = None
    max_exposure_ns: Count | None = None
    min_frame_duration_ns: Count | None = None
    max_frame_duration_ns: Count | None = None
    """Shortest and longest duration of one frame, if the duration of each frame can be set."""
    stamp: StampAccuracy | None = None
    """Timestamp bias, if reported or measured; None otherwise, see `stamp_accuracy`."""
    label: Label = ""
    """What its owner calls it, in any script; absent if that is its name."""

    def called(self, name: str) -> str:
        """Return what people call the camera, which has this name."""
        return self.label or name

    @property
    def stamp_accuracy(self) -> StampAccuracy:
        """Timestamp bias as known or, failing that, assumed; exact for a simulated camera."""
        return self.stamp or (EXACT_STAMPS if self.kind == SIMULATED else self.assumed_stamp)

    @property
    def shared_uncertainty_ns(self) -> int:
        """95 % timestamp uncertainty shared with the cameras measured against the same reference camera.

        If the reference's uncertainty is unknown, the result is the uncertainty of this camera's assumed
        timestamps.
        """
        known, assumed_ns = self.stamp_accuracy, self.assumed_stamp.uncertainty_ns
        against_ns = known.against_uncertainty_ns if known.against else 0
        return assumed_ns if against_ns is None else against_ns

    @property
    def assumed_stamp(self) -> StampAccuracy:
        """Bias and uncertainty to assume for a driver whose claims are untested.

        The time from the start of the exposure to the timestamp is at least 0. It is at most the exposure, a
        frame's readout and its delivery. An unknown exposure may last a whole period, and a readout too.
        """
        exposure_ns = self.period_ns if self.exposure_ns is None else min(self.exposure_ns, self.period_ns)
        latest_ns = exposure_ns + self.period_ns + DELIVERY_NS
        if self._claimed_start_ns(0, self.exposure_ns) is None:
            latest_ns += self.period_ns
        half_ns = min(latest_ns // 2, MAX_STAMP_NS)
        return StampAccuracy(bias_ns=half_ns, uncertainty_ns=half_ns, source=StampSource.ASSUMED)

    def exposure_start_ns(self, stamp_ns: int, exposure_ns: int | None) -> int | None:
        """Return the start of exposure of a frame's first row, in the clock of the frame's timestamp.

        A timestamp at the end of the frame is later by the exposure and the readout of all rows but the
        first. The known timestamp bias is subtracted. None if the moment of the timestamp, or a required
        correction, is unknown.
        """
        accuracy, claimed_ns = self.stamp_accuracy, self._claimed_start_ns(stamp_ns, exposure_ns)
        if claimed_ns is None and accuracy.source in _OF_THE_STAMP_ITSELF:
            claimed_ns = stamp_ns
        return None if claimed_ns is None else claimed_ns - accuracy.bias_ns

    def start_offset_ns(self) -> int:
        """Return the estimated time from a frame's timestamp to its first row's start of exposure."""
        start_ns = self.exposure_start_ns(0, self.exposure_ns)
        return -self.stamp_accuracy.bias_ns if start_ns is None else start_ns

    def mid_exposure_offset_ns(self, height_fraction: float) -> int | None:
        """Return the time from a frame's timestamp to the middle of exposure of the row at `height_fraction`.

        `height_fraction` is a fraction of the height. None if the camera's row time or exposure, or the
        moment of the timestamp, is unknown.
        """
        start_ns = self.exposure_start_ns(0, self.exposure_ns)
        if start_ns is None or self.exposure_ns is None or self.row_time_ns is None:
            return None
        return (
            start_ns + round(height_fraction * (self.height - 1)) * self.row_time_ns + self.exposure_ns // 2
        )

    def _claimed_start_ns(self, stamp_ns: int, exposure_ns: int | None) -> int | None:
        """Return the start of the first row's exposure according to the driver; None if unknown."""
        if self.timestamp_source is TimestampSource.START_OF_EXPOSURE:
            return stamp_ns
        known = self.timestamp_source is TimestampSource.END_OF_FRAME
        if not known or exposure_ns is None or self.row_time_ns is None:
            return None
        return stamp_ns - exposure_ns - (self.height - 1) * self.row_time_ns


def unshared_uncertainties_ns(cameras: Mapping[str, CameraFacts]) -> dict[str, int]:
    """Return each camera's 95 % timestamp uncertainty that is neither in `uncertainty_ns` nor common to all.

    0 if all were measured against one reference camera in one mode: its unknown bias cancels between them. It
    does not cancel against a camera with a known bias, or with another reference.
    """
    shared_ns = {name: camera.shared_uncertainty_ns for name, camera in cameras.items()}
    origins = {(camera.stamp_accuracy.against, shared_ns[name]) for name, camera in cameras.items()}
    return dict.fromkeys(cameras, 0) if len(origins) < 2 else shared_ns


class Control(StrEnum):
    """Control of an image's appearance, besides the lens."""

    EXPOSURE = "exposure"
    GAIN = "gain"
    WHITE_BALANCE = "white-balance"
    FOCUS = "focus"


ControlValue = Real | Literal["auto", "hold"]
"""Value in the control's unit; auto: the camera chooses; hold: the automatic value is frozen."""


def parse_settings(texts: Iterable[str]) -> dict[Control, ControlValue]:
    """Return the values of controls written as CONTROL=VALUE. Raises BadInputError."""
    settings: dict[Control, ControlValue] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name not in tuple(Control):
            raise BadInputError(
                f"no control {name!r}",
                hint=f"write CONTROL=VALUE, with one of {', '.join(Control)}; ISO is gain, and a shutter of "
                "1/125 s is exposure=8000; frame rate and size are of the camera's start: "
                "capture-app node --camera SPEC,fps=N,width=W",
            )
        try:
            settings[Control(name)] = convert(value, ControlValue, strict=False)
        except ValidationError:
            raise BadInputError(
                f"{name}={value} is not a number, auto or hold", hint="exposure=4000 is 4 ms"
            ) from None
    return settings


def steps_of(model: str) -> str:
    """Return the unit of a control whose steps are comparable between cameras of one model only."""
    return f"steps of {model}"[:200]


class ControlState(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Current state of one control of a camera."""

    control: Control
    value: Real | None = None
    """Value in `unit`; None if the camera does not report it."""
    unit: Text
    """Unit of the values; only values of equal units are comparable between cameras."""
    automatic: bool = False
    """Whether the camera chooses the value, frame by frame."""
    can_be_automatic: bool = False
    minimum: Real | None = None
    maximum: Real | None = None
    """Range of the values that can be set; None if none can."""

    @property
    def can_be_set(self) -> bool:
        """Whether users can set a value for this control."""
        return self.minimum is not None and self.maximum is not None

    def clamped(self, value: float) -> float:
        """Return the value clamped to the range."""
        if self.minimum is None or self.maximum is None:
            return value
        return min(max(value, self.minimum), self.maximum)


def describe(state: ControlState | None) -> str:
    """Return a control's value as text; a dash without a state."""
    if state is None:
        return "-"
    value = "?" if state.value is None else f"{float(f'{state.value:.5g}'):g} {state.unit}"
    return f"{value}, auto" if state.automatic else value


class CameraControls(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Controls of a camera, and the failed parts of a request."""

    controls: Annotated[tuple[ControlState, ...], Meta(max_length=16)] = ()
    problems: dict[Control, Sentence] = field(default_factory=dict)
    """Reason of each failure, in plain words."""

    def state(self, control: Control) -> ControlState | None:
        """Return the state of a control; None if the camera does not have it."""
        return next((state for state in self.controls if state.control is control), None)


def describe_stamp(stamp: StampAccuracy) -> str:
    """Describe the delay of a camera's timestamps: 21 ms ±21 ms late, assumed."""
    if stamp.is_exact and not stamp.bias_ns:
        return f"exact, {_SOURCES[stamp.source]}"
    late = f"{duration(abs(stamp.bias_ns))} ±{duration(stamp.uncertainty_ns)}"
    against = f" against {stamp.against}, whose own bias is unknown" if stamp.against else ""
    return f"{late} {'late' if stamp.bias_ns >= 0 else 'early'}, {_SOURCES[stamp.source]}{against}"


def unmeasured_stamps(cameras: Mapping[str, CameraFacts]) -> str:
    """Name the cameras whose timestamp delay is not measured, or not against all others; empty for none.

    The text also names the command that measures it.
    """
    unsure = {
        name: camera.stamp_accuracy.uncertainty_ns
        for name, camera in cameras.items()
        if camera.stamp_accuracy.source in UNMEASURED
    }
    # Delays measured against different reference cameras are reported only if every camera has a measurement.
    against = {name: error_ns for name, error_ns in unshared_uncertainties_ns(cameras).items() if error_ns}
    if not (unsure := unsure or against):
        return ""
    worst = max(unsure, key=unsure.__getitem__)
    others = f" and of {count(len(unsure) - 1, 'more camera')}" if len(unsure) > 1 else ""
    reference = cameras[worst].stamp_accuracy.against
    known = cameras.get(reference, cameras[worst]).called(reference)
    by_what = f" except against {known}" if unsure is against else ""
    return (
        f"stamp error of {cameras[worst].called(worst)}{others} not measured{by_what}"
        f" (±{duration(unsure[worst])}): {REMEDY} measures it"
    )
