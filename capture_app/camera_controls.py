"""Exposure, gain, white balance and focus: what cameras tell of them, and what they can be told."""

from enum import StrEnum
from typing import Literal

from msgspec import Struct, field

from capture_app.camera_facts import Text


class Control(StrEnum):
    """What decides how a picture looks, beside the lens."""

    EXPOSURE = "exposure"
    GAIN = "gain"
    WHITE_BALANCE = "white-balance"
    FOCUS = "focus"


MICROSECONDS, TIMES, KELVIN, DIOPTRES = "µs", "×", "K", "dpt"
"""Units that mean the same with every camera: exposure, gain, white balance, focus."""
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
