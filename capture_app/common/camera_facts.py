"""What a camera is and can do, its controls too: structs that drivers fill in, nodes send, sessions keep."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Literal

from msgspec import Meta, Struct, field

Text = Annotated[str, Meta(max_length=200)]
Count = Annotated[int, Meta(ge=0)]
Positive = Annotated[int, Meta(gt=0)]

SIMULATED, PHONE = "sim", "phone"
"""The kind of every simulated camera."""
MOST_STAMP_NS = 10_000_000_000
"""No stamp is further from its light, and none less surely known."""
DELIVERY_NS = 5_000_000
"""How much later than a frame's readout a driver may stamp it, where nothing is known of it."""
MICROSECONDS, TIMES, KELVIN, DIOPTRES = "µs", "×", "K", "dpt"
"""Units that mean the same with every camera: exposure, gain, white balance, focus."""


class CameraListing(Struct, frozen=True):
    """A camera of this machine: its spec, and what it is in words; where it is not usable, why."""

    spec: str
    kind: str
    model: str
    detail: str
    usable: bool = True


class TimestampSource(StrEnum):
    """The moment of a frame that the driver stamps."""

    START_OF_EXPOSURE = "start-of-exposure"
    END_OF_FRAME = "end-of-frame"
    UNKNOWN = "unknown"


class PhaseControl(StrEnum):
    """How the phase of a stream can be moved."""

    FRAME_DURATION = "frame-duration"
    INJECTION = "injection"
    RESET = "reset"
    NONE = "none"


class StampSource(StrEnum):
    """How it is known how late a camera's stamps are."""

    CONSTRUCTION = "construction"
    """It is simulated: its stamps are what they are said to be."""
    DRIVER = "driver"
    """The driver tells, and can be believed."""
    PROFILE = "profile"
    """What is known of cameras of this kind."""
    MOTION = "motion"
    """Measured by what moved in its pictures and in others'."""
    LIGHT = "light"
    """Measured by a light that blinked."""
    ASSUMED = "assumed"
    """Nothing is known but that a picture is stamped after its light, and not long after it is read out."""


_OF_THE_STAMP_ITSELF = {StampSource.DRIVER, StampSource.PROFILE, StampSource.MOTION, StampSource.LIGHT}


class StampAccuracy(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """How late a camera's stamps are, and how well that is known; times in ns."""

    bias_ns: Annotated[int, Meta(ge=-MOST_STAMP_NS, le=MOST_STAMP_NS)]
    """The start of the first row's exposure by the stamp and its `TimestampSource`, minus the true start.

    Where the stamp's moment, or what must be taken off it, is not known: the stamp itself minus that start.
    """
    uncertainty_ns: Annotated[int, Meta(ge=0, le=MOST_STAMP_NS)]
    """95 % error of the bias."""
    source: StampSource
    exposure_ns: Count | None = None
    """The exposure that it holds for; None where it holds for any, or that is not known."""
    against: Text = ""
    """The camera by whose stamps it was measured, though nobody knows how late those are; empty for none."""
    against_uncertainty_ns: Annotated[int, Meta(ge=0, le=MOST_STAMP_NS)] | None = None
    """95 % error of what those stamps were taken for: not in `uncertainty_ns`, as it cancels between the
    cameras that share it."""

    @property
    def is_exact(self) -> bool:
        """Whether the stamps add no error at all, as nothing but a simulation can promise."""
        return self.source is StampSource.CONSTRUCTION and self.uncertainty_ns == 0


EXACT_STAMPS = StampAccuracy(bias_ns=0, uncertainty_ns=0, source=StampSource.CONSTRUCTION)


class CameraFacts(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """What a camera is and can do, fixed while it streams; times in ns, None where they are not known."""

    kind: Text
    """Its driver, such as v4l2 or sim; imported for a recording; clock or relay where there is no camera."""
    model: Text
    width: Count
    """In pixels, as the height; 0 for a node without a camera."""
    height: Count
    period_ns: Positive
    timestamp_source: TimestampSource
    phase_control: PhaseControl
    pixel_format: Text = ""
    """How the driver delivers pictures, such as MJPG; empty where it is not known."""
    row_time_ns: Count | None = None
    """Readout time of one row."""
    exposure_ns: Count | None = None
    min_exposure_ns: Count | None = None
    max_exposure_ns: Count | None = None
    min_frame_duration_ns: Count | None = None
    max_frame_duration_ns: Count | None = None
    """Shortest and longest time that one frame can last, where the duration of each can be set."""
    stamp: StampAccuracy | None = None
    """How late its stamps are; None where nobody has said, see `stamp_accuracy`."""

    @property
    def stamp_accuracy(self) -> StampAccuracy:
        """How late its stamps are: what is said, or what must be assumed; a simulated camera's are exact."""
        if self.stamp is not None:
            return self.stamp
        return EXACT_STAMPS if self.kind == SIMULATED else self.assumed_stamp

    @property
    def shared_uncertainty_ns(self) -> int:
        """95 % error of its stamps that it has in common with cameras measured against the same one.

        Where nobody said how well that one's are known, as little as of this camera before it was measured.
        """
        known = self.stamp_accuracy
        if not known.against:
            return 0
        told_ns = known.against_uncertainty_ns
        return self.assumed_stamp.uncertainty_ns if told_ns is None else told_ns

    @property
    def assumed_stamp(self) -> StampAccuracy:
        """What must be assumed of a driver whose claims nobody has tested.

        Between the start of the exposure and the stamp lie at most the exposure, a frame's readout and its
        delivery; at least nothing. An exposure that is not known may be a whole period, a readout too.
        """
        exposure_ns = self.period_ns if self.exposure_ns is None else min(self.exposure_ns, self.period_ns)
        latest_ns = exposure_ns + self.period_ns + DELIVERY_NS
        if self._claimed_start_ns(0, self.exposure_ns) is None:
            latest_ns += self.period_ns
        half_ns = min(latest_ns // 2, MOST_STAMP_NS)
        return StampAccuracy(bias_ns=half_ns, uncertainty_ns=half_ns, source=StampSource.ASSUMED)

    def exposure_start_ns(self, stamp_ns: int, exposure_ns: int | None) -> int | None:
        """When the exposure of a frame's first row begins, by the clock of the frame's stamp.

        A stamp at the end of the frame is later by the exposure and the readout of all rows but the first;
        what is known of the stamps' bias is taken off. None where the stamp's moment, or what would be taken
        off it, is not known.
        """
        accuracy, claimed_ns = self.stamp_accuracy, self._claimed_start_ns(stamp_ns, exposure_ns)
        if claimed_ns is None and accuracy.source in _OF_THE_STAMP_ITSELF:
            claimed_ns = stamp_ns
        return None if claimed_ns is None else claimed_ns - accuracy.bias_ns

    def start_offset_ns(self) -> int:
        """Time from a frame's stamp to the start of its first row's exposure, as well as that is known."""
        start_ns = self.exposure_start_ns(0, self.exposure_ns)
        return -self.stamp_accuracy.bias_ns if start_ns is None else start_ns

    def mid_exposure_offset_ns(self, height_share: float) -> int | None:
        """Time from a frame's stamp to the middle of a row's exposure; the row at that share of the height.

        None where the camera's rows or exposure, or the stamp's moment, is not known.
        """
        start_ns = self.exposure_start_ns(0, self.exposure_ns)
        if start_ns is None or self.exposure_ns is None or self.row_time_ns is None:
            return None
        return start_ns + round(height_share * (self.height - 1)) * self.row_time_ns + self.exposure_ns // 2

    def _claimed_start_ns(self, stamp_ns: int, exposure_ns: int | None) -> int | None:
        """The start of the first row's exposure by what the driver claims of its stamps."""
        if self.timestamp_source is TimestampSource.START_OF_EXPOSURE:
            return stamp_ns
        known = self.timestamp_source is TimestampSource.END_OF_FRAME
        if not known or exposure_ns is None or self.row_time_ns is None:
            return None
        return stamp_ns - exposure_ns - (self.height - 1) * self.row_time_ns


def unshared_uncertainties_ns(cameras: Mapping[str, CameraFacts]) -> dict[str, int]:
    """95 % error of each camera's stamps that its `uncertainty_ns` leaves out and the others do not share.

    0 where all were measured against one camera, in one mode of it: what nobody knows of that one cancels
    between them. Against a camera whose stamps are known, or were measured against another, it does not.
    """
    shared_ns = {name: camera.shared_uncertainty_ns for name, camera in cameras.items()}
    origins = {(camera.stamp_accuracy.against, shared_ns[name]) for name, camera in cameras.items()}
    return dict.fromkeys(cameras, 0) if len(origins) < 2 else shared_ns


class Control(StrEnum):
    """What decides how a picture looks, beside the lens."""

    EXPOSURE = "exposure"
    GAIN = "gain"
    WHITE_BALANCE = "white-balance"
    FOCUS = "focus"


ControlValue = float | Literal["auto", "hold"]
"""A value in the control's unit; or that the camera chooses; or that what it has chosen is kept."""


def steps_of(model: str) -> str:
    """The unit of a control whose steps mean something with cameras of one model only."""
    return f"steps of {model}"[:200]


class ControlState(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One control of a camera as it stands."""

    control: Control
    value: float | None = None
    """In `unit`; None where the camera does not tell."""
    unit: Text
    """Values compare between cameras only where their units are the same."""
    automatic: bool = False
    """The camera chooses it, frame by frame."""
    can_be_automatic: bool = False
    least: float | None = None
    most: float | None = None
    """The range of what can be set; None where nothing can."""

    @property
    def can_be_set(self) -> bool:
        """Whether it takes a value."""
        return self.least is not None and self.most is not None

    def clamped(self, value: float) -> float:
        """The value nearest to one asked for within the range."""
        if self.least is None or self.most is None:
            return value
        return min(max(value, self.least), self.most)


def describe(state: ControlState | None) -> str:
    """A control's value in words, a dash where there is none."""
    if state is None:
        return "-"
    value = "?" if state.value is None else f"{float(f'{state.value:.5g}'):g} {state.unit}"
    return f"{value}, auto" if state.automatic else value


class CameraControls(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The controls of a camera, and what could not be done of what was asked for."""

    controls: tuple[ControlState, ...] = ()
    problems: dict[Control, str] = field(default_factory=dict)
    """Why, in plain words."""

    def state(self, control: Control) -> ControlState | None:
        """That control's, None where the camera has none."""
        return next((state for state in self.controls if state.control is control), None)
