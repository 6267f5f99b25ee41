"""Panel readings of one camera's recording: the camera's own times, and the refreshes that it saw then."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError
from capture_app.companions.panel.finder import Floats
from capture_app.companions.panel.pattern import Panel, nearest_ns
from capture_app.companions.panel.time_reading import SIGMAS_95, PanelTime

VISIT_GAP_S = 3.0
"""Minimum time without the panel between two visits of it."""
NO_CYCLE = "its panel does not show which cycle it is in: show it with capture-app panel show of this version"


@dataclass(frozen=True, slots=True)
class TrackReading:
    """A panel's time in an image, and the image's time by its camera: both of its middle row's exposure."""

    own_s: float
    read: PanelTime
    row: float
    """The image's middle row."""


@dataclass(frozen=True, eq=False)
class PanelTrack:
    """All of a camera's readings (n,), in order of its own times."""

    panel: Panel
    page: int
    """Number of the page that drew the panel."""
    own_s: Floats
    shown_s: Floats
    """Number of refreshes since the page was loaded, times the panel's nominal tick, s."""
    sd_s: Floats
    visit: NDArray[np.intp]
    """Number of the visit that a reading belongs to: a time in which the camera saw the panel."""
    alike: float = 1.0
    """Part of a reading's error that readings at one place in the refresh have in common; 0 for frames that
    were read together."""


def make_track(readings: Sequence[TrackReading], *, alike: float = 1.0) -> PanelTrack:
    """Return the track of readings, whose cycle codes show the pattern's repetition.

    Raises BadInputError with a short reason if they show several panels, or no cycle.
    """
    panels = sorted({reading.read.panel.name for reading in readings})
    if len(panels) > 1:
        raise BadInputError(f"it saw several panels, {' and '.join(panels)}: show one screen to all cameras")
    pages = Counter(reading.read.cycle.page for reading in readings if reading.read.cycle is not None)
    if not pages:
        raise BadInputError(NO_CYCLE)
    # A misread code passes its checksum once in 64 times.
    (page, _), *others = pages.most_common()
    if any(count > max(1, len(readings) // 8) for _, count in others):
        raise BadInputError(
            "the panel's page was loaded again meanwhile, or it saw two screens: show one page"
        )
    panel = readings[0].read.panel
    in_order = sorted(readings, key=lambda reading: reading.own_s)
    own_s = np.array([reading.own_s for reading in in_order])
    visit = np.concatenate([[0], np.cumsum(np.diff(own_s) > VISIT_GAP_S)])
    reads = [reading.read.at_row(reading.row) for reading in in_order]
    shown_s = np.full(len(in_order), np.nan)
    for number in range(int(visit[-1]) + 1):
        members = np.flatnonzero(visit == number)
        since_load_s = [
            in_order[k].read.cycle.number * panel.cycle_ns / 1e9  # type: ignore[union-attr]
            if in_order[k].read.cycle is not None and in_order[k].read.cycle.page == page  # type: ignore[union-attr]
            else None
            for k in members
        ]
        shown_s[members] = _unwrap(
            own_s[members], np.array([reads[k][0] for k in members]) / 1e9, since_load_s, panel.cycle_ns / 1e9
        )
    known = np.isfinite(shown_s)
    sd_s = np.array([error_ns for _, error_ns in reads]) / SIGMAS_95 / 1e9
    return PanelTrack(panel, page, own_s[known], shown_s[known], sd_s[known], visit[known], alike)


def _unwrap(own_s: Floats, within_s: Floats, since_load_s: Sequence[float | None], cycle_s: float) -> Floats:
    """Return a visit's times since the page was loaded; NaN if none of its cycle codes was readable.

    `within_s` are modulo the cycle. Own times show the number of cycles between two readings of a visit, and
    most codes must agree on the first reading's cycle.
    """
    since_s = own_s - own_s[0]
    steps_s = [nearest_ns(w - within_s[0] - s, cycle_s) for w, s in zip(within_s, since_s, strict=True)]
    continuous_s = within_s[0] + since_s + np.array(steps_s)
    votes = Counter(
        round((start_s + within - continuous) / cycle_s)
        for start_s, within, continuous in zip(since_load_s, within_s, continuous_s, strict=True)
        if start_s is not None
    )
    if not votes:
        return np.full(len(own_s), np.nan)
    return np.asarray(continuous_s + votes.most_common(1)[0][0] * cycle_s)
