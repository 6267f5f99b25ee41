"""The exposure and gain of a simulated camera, held or chosen by itself."""

import math

from capture_app.camera_controls import MICROSECONDS, TIMES, Control, ControlState
from capture_app.errors import CameraError
from capture_app.simulation.devices.profiles import SensorProfile

MOST_GAIN = 16.0
WANDER, WANDER_NS = 0.3, 10_000_000_000
"""An exposure that the camera chooses goes up and down by this share, once in so long, as under clouds."""


class SimulatedControls:
    """What a simulated camera exposes by, as its profile allows; the gain changes no picture."""

    def __init__(self, profile: SensorProfile, *, automatic: bool) -> None:
        self._profile = profile
        self._held_ns = self._chosen_ns = self._whole(profile.exposure_ns)
        self.automatic = automatic
        """Whether it chooses its exposure itself."""
        self.gain = 1.0

    @property
    def exposure_ns(self) -> int:
        """The exposure of the frames to come, in whole rows."""
        return self._chosen_ns if self.automatic else self._held_ns

    def let_time_pass(self, true_ns: int) -> bool:
        """Choose the exposure anew, where it is automatic; whether it has changed."""
        if not self.automatic:
            return False
        before = self._chosen_ns
        share = 1.0 + WANDER * math.sin(2.0 * math.pi * (true_ns % WANDER_NS) / WANDER_NS)
        self._chosen_ns = self._whole(share * self._profile.exposure_ns)
        return self._chosen_ns != before

    def states(self) -> tuple[ControlState, ...]:
        """Both, as they stand."""
        least_ns, most_ns = self._whole(0), self._whole(self._profile.period_ns)
        exposure = ControlState(
            control=Control.EXPOSURE,
            value=self.exposure_ns / 1000,
            unit=MICROSECONDS,
            automatic=self.automatic,
            can_be_automatic=True,
            least=least_ns / 1000,
            most=most_ns / 1000,
        )
        gain = ControlState(control=Control.GAIN, value=self.gain, unit=TIMES, least=1.0, most=MOST_GAIN)
        return exposure, gain

    def set(self, control: Control, value: float | None) -> None:
        """Set one of them; None: let the camera choose. Raises CameraError where it cannot."""
        if control is Control.EXPOSURE:
            self.automatic = value is None
            if value is not None:
                self._held_ns = self._whole(value * 1000)
        elif control is Control.GAIN and value is not None:
            self.gain = min(max(value, 1.0), MOST_GAIN)
        else:
            raise CameraError(f"a simulated camera does not choose its {control}, or has none")

    def _whole(self, exposure_ns: float) -> int:
        """An exposure that stretches no frame, in whole rows."""
        rows = self._profile.whole_rows(round(exposure_ns))
        least = -(-self._profile.min_exposure_ns // self._profile.row_time_ns)
        return max(least, min(rows, self._profile.neutral_rows)) * self._profile.row_time_ns
