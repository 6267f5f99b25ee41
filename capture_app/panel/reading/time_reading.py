"""Reads the time off a picture of a panel, with an error bar, or says why it cannot."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.panel.pattern import Panel
from capture_app.panel.reading.finder import FoundPanel, PanelFinder
from capture_app.panel.reading.lamp_light import measure
from capture_app.panel.reading.light_model import LightModel, Shutter
from capture_app.panel.reading.posterior import Freedom, PanelUnreadableError, gather
from capture_app.panel.reading.time_search import possible_shutters, search
from capture_app.text import duration

Floats = NDArray[np.float64]

_MISFIT = 4.0
_MAX_MISFITS = 0.12
"""A panel of which more lamps than this share misfit by as many sigmas is not what its markers say."""
_MAX_RMS, _SCREEN_MAX_RMS = 1.3, 3.5
"""Nor is one whose lamps misfit by as many sigmas on the whole; usual are 0.3 to 1, of slow screens 2."""
_MAX_TICKS = 2.0
"""An error bar of more ticks of LEDs tells no time that they are for."""
_MIN_CONTRAST, _MIN_LIGHT = 4.0, 0.005
"""Lamps that are lit must stand out by this factor from the noise, and by this share of a full sensor."""
_SCREEN_MODEL_TICKS = 0.06
"""What is not known of how a screen draws and how slowly its cells change, in refreshes."""
_LED_MODEL_NS = 6_000.0
"""What is not known of where lamps' middles are, and of the switching of LEDs."""
_PLACE_SHARE = 1.0
"""Of the error of the markers' corners, how far all lamps may be off together."""
_UNSEEN_BEND = 0.12
"""Pitches by which a lens may bend a panel of which only three markers are seen."""
_TONE_SHARE = 0.12
"""By how much a tone curve may misjudge the share for which a lamp was lit."""


@dataclass(frozen=True, slots=True)
class PanelTime:
    """When a picture was taken by a panel, in ns of its cycle."""

    panel: Panel
    middle_ns: float
    """Middle of the exposure of row `row`."""
    uncertainty_ns: float
    """The middle is within this with a chance of 95 %."""
    row: float
    """Row of the picture in which the panel's middle lies."""
    shutter: Shutter
    """As told, or as it fits best."""
    row_time_error_ns: float
    """The row time is within this with a chance of 95 %; 0 where it was told."""
    markers: int
    misfit: float
    """Root mean square misfit of the lamps, in sigmas."""

    def at_row(self, row: float) -> tuple[float, float]:
        """Middle of that row's exposure, in ns of the panel, and its 95 % error."""
        away = row - self.row
        error_ns = float(np.hypot(self.uncertainty_ns, away * self.row_time_error_ns))
        return self.middle_ns + away * self.shutter.row_time_ns, error_ns


def read_panel(
    picture: NDArray[np.uint8], *, exposure_ns: float | None = None, row_time_ns: float | None = None
) -> PanelTime:
    """The time that a panel tells in a picture (uint8, BGR); nobody need say which panel or where it is.

    Exposure and row time that are None are found with it. Raises PanelNotFoundError where there is no panel,
    and PanelUnreadableError where it tells no time or not one time.
    """
    found = PanelFinder().find(np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8))
    return read_found(found, picture, exposure_ns=exposure_ns, row_time_ns=row_time_ns)


def read_found(
    found: FoundPanel,
    picture: NDArray[np.uint8],
    *,
    exposure_ns: float | None = None,
    row_time_ns: float | None = None,
) -> PanelTime:
    """As `read_panel`, of a panel that is found already."""
    model = LightModel(found.panel, measure(found, picture))
    _, on = model.rough_fit()
    dark, bright = np.percentile(model.seen.light, (20, 97))
    if bright - dark < _MIN_CONTRAST * model.seen.noise + _MIN_LIGHT:
        raise PanelUnreadableError(
            "its lamps do not stand out: too dark, too short an exposure, or switched off"
        )
    free = Freedom(exposure_ns is None, row_time_ns is None)
    shutters = possible_shutters(found.panel, exposure_ns, row_time_ns)
    posterior = gather(model, search(model, shutters), free)
    best = posterior.best
    shares = model.shares(np.array([best.middle_ns]), best.shutter)
    misfit = model.fit(shares, on).misfit[0]
    wrong = float((np.abs(misfit) > _MISFIT).mean())
    rms = float(np.sqrt(np.mean(np.minimum(misfit**2, 25))))
    if wrong > _MAX_MISFITS or rms > (_SCREEN_MAX_RMS if found.panel.is_screen else _MAX_RMS):
        raise PanelUnreadableError(
            f"its lamps do not shine as those of {found.panel.name} would at any time: is it that panel, are "
            "exposure and row time right, is it hidden or too blurred?"
        )
    middle_ns, spread_ns = posterior.interval()
    if found.panel.is_screen:
        model_ns = _SCREEN_MODEL_TICKS * found.panel.tick_ns
    else:
        partly_ns = min(best.shutter.exposure_ns, found.panel.tick_ns)
        # Where a lamp's middle is misjudged, so is the time of its row.
        place = found.error if found.markers == 4 else found.error + _UNSEEN_BEND
        place_ns = _PLACE_SHARE * place * found.pitch_px * best.shutter.row_time_ns
        model_ns = float(np.linalg.norm([_LED_MODEL_NS, _TONE_SHARE * partly_ns, place_ns]))
    row_time_ns, row_time_error_ns = posterior.row_time()
    uncertainty_ns = float(np.hypot(spread_ns, model_ns)) * max(1.0, rms)
    if not found.panel.is_screen and uncertainty_ns > _MAX_TICKS * found.panel.tick_ns:
        raise PanelUnreadableError(
            f"its time is known to ±{duration(uncertainty_ns)} only: expose shorter, not whole "
            "turns of the panel"
        )
    return PanelTime(
        found.panel,
        middle_ns % found.panel.cycle_ns,
        uncertainty_ns,
        model.row,
        Shutter(best.shutter.exposure_ns, row_time_ns),
        row_time_error_ns,
        found.markers,
        rms,
    )
