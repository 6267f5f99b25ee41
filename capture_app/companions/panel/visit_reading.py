"""Readings of one visit of a screen's panel: all frames share a shutter, a screen, and one line of time.

A single frame often bounds its time by half a refresh only: a lit column shows how far the screen has drawn
only while the drawing passes over it. Frames at other places in the refresh bound it from both sides, and
know the exposure far better together than each alone. So the likelihoods of all frames are added along each
line of time, for each shutter and each response of the screen's cells.
"""

from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.companions.panel.cycle_code import Cycle
from capture_app.companions.panel.cycle_reading import read_cycle
from capture_app.companions.panel.finder import Floats, PanelNotFoundError, find_panel
from capture_app.companions.panel.light_model import LightModel, Shutter
from capture_app.companions.panel.panel_track import TrackReading
from capture_app.companions.panel.time_reading import SHORTEST_NS, SIGMAS_95, PanelTime, read_panel

Image = NDArray[np.uint8]
HALF_TICKS, ROUGH_STEPS, FINE_STEPS = 1.5, 16, 64
"""Range of a frame's time around the first line, in refreshes, and steps of a refresh."""
RATES, RATE_STEPS = 4e-3, 41
"""Range of the line's slope around the first one, and number of slopes."""
EXPOSURES, ROW_TIMES = 10, 5
"""Number of exposures and row times that are tried first."""
TONES = np.array([0.9, 1.0, 1.1])
"""Tone curves that are tried; see `LightModel.fit`."""
RESPONSES_NS = (0.3e6, 1e6, 2e6, 3.2e6, 4.5e6)
"""Time constants of a screen's cells."""
TEMPER = 0.3
"""Weight of the log-likelihood: a lamp's residuals are alike in all frames."""
ODD = 1e-4
"""Probability of a frame that shows a missed refresh, and so no time."""


@dataclass(frozen=True, slots=True)
class Screening:
    """Shutter of a camera, and time constant of the screen's cells, ns."""

    shutter: Shutter
    response_ns: float


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame with a panel: its time by the camera, its light, and its cycle code."""

    own_s: float
    model: LightModel
    middle_row: float
    cycle: Cycle | None


class Visit:
    """All frames of a visit, and the line of time near which they are compared."""

    def __init__(self, frames: Sequence[Frame], alone: TrackReading) -> None:
        """`alone` is a reading of one of the frames, right to a refresh."""
        self.frames = frames
        self.tick_ns = frames[0].model.panel.tick_ns
        self.own_ns = np.array([frame.own_s for frame in frames]) * 1e9
        self.middle_ns = float(self.own_ns.mean())
        self.base_ns = alone.read.at_row(alone.row)[0] + self.own_ns - alone.own_s * 1e9
        self.steps_ns = self._steps(ROUGH_STEPS)
        self.rates = np.linspace(-RATES, RATES, RATE_STEPS)

    def _steps(self, a_tick: int) -> Floats:
        half_width = round(HALF_TICKS * a_tick)
        return np.arange(-half_width, half_width + 1) * self.tick_ns / a_tick

    def refine(self) -> None:
        """Compare times in finer steps from now on."""
        self.steps_ns = self._steps(FINE_STEPS)

    def line_scores(self, of: Screening) -> Floats:
        """Return the log-likelihood (rates, steps) of each line of time: rate, and time at the middle."""
        total = np.zeros((len(self.rates), len(self.steps_ns)))
        for frame, own_ns, base_ns in zip(self.frames, self.own_ns, self.base_ns, strict=True):
            scores = self._frame_scores(frame, base_ns, of)
            later_ns = self.rates * (own_ns - self.middle_ns)
            for row, at_ns in enumerate(later_ns):
                total[row] += np.interp(self.steps_ns + at_ns, self.steps_ns, scores)
        return total

    def _frame_scores(self, frame: Frame, base_ns: float, of: Screening) -> Floats:
        model = frame.model
        # A model's times refer to its panel's row.
        shift_ns = (model.row - frame.middle_row) * of.shutter.row_time_ns
        shares = model.shares_in_steps(base_ns + self.steps_ns + shift_ns, of.shutter, of.response_ns)
        likelihood, _ = model.fit(shares, model.rough_fit[1], TONES)
        scores = TEMPER * likelihood
        return np.asarray(np.logaddexp(scores, scores.max() + np.log(ODD)))


def read_visit(
    images: Sequence[tuple[float, Image]], limits: Shutter, reasons: Counter[str]
) -> Iterator[TrackReading]:
    """Yield a reading of each frame with a readable panel, all on the likeliest line of time.

    `images` are the camera's times (s) and the frames, BGR; `limits` the longest shutter of such a video.
    `reasons` counts why frames were refused. Uncertainties are stated as if independent: each is the line's,
    times the root of the number of frames.
    """
    frames = list[Frame]()
    alone: TrackReading | None = None
    # One frame is read alone, which gives the time to a refresh: the one nearest to the visit's middle.
    middle_s = (images[0][0] + images[-1][0]) / 2
    for own_s, image in sorted(images, key=lambda one: abs(one[0] - middle_s)):
        try:
            frame = _look(own_s, image)
            if alone is None:
                alone = TrackReading(own_s, read_panel(image, longest=limits), frame.middle_row)
        except PanelNotFoundError as error:
            reasons[str(error)] += 1
        else:
            frames.append(frame)
    if alone is not None:
        of_panel = [one for one in frames if one.model.panel == alone.read.panel]
        visit = Visit(of_panel, alone)
        yield from _readings(visit, alone.read, _search(visit, limits))


def _look(own_s: float, image: Image) -> Frame:
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    placed = find_panel(grey)
    return Frame(own_s, LightModel(placed, image), (image.shape[0] - 1) / 2, read_cycle(placed, grey))


def _search(visit: Visit, limits: Shutter) -> Mapping[Screening, Floats]:
    """Return the shutters and responses near the likeliest ones, with their lines' log-likelihoods."""
    shortest_ns = min(SHORTEST_NS, limits.exposure_ns)
    exposures = np.geomspace(shortest_ns, limits.exposure_ns, EXPOSURES)
    row_times = np.linspace(0, limits.row_time_ns, ROW_TIMES)
    rough = _score(visit, product(exposures, row_times, (RESPONSES_NS[1],)))
    best = max(rough, key=lambda of: float(rough[of].max()))
    visit.refine()
    tried: dict[Screening, Floats] = {}
    factor, step_ns = float(exposures[1] / exposures[0]) ** 0.5, limits.row_time_ns / (ROW_TIMES - 1) / 2
    for responses in (RESPONSES_NS, None, None):
        near = product(
            np.minimum(best.shutter.exposure_ns * factor ** np.array([-1, 0, 1]), limits.exposure_ns),
            np.clip(best.shutter.row_time_ns + step_ns * np.array([-1, 0, 1]), 0, limits.row_time_ns),
            responses or _beside(best.response_ns),
        )
        tried |= _score(visit, near, known=tried)
        best = max(tried, key=lambda of: float(tried[of].max()))
        factor, step_ns = factor**0.5, step_ns / 2
    return tried


def _score(
    visit: Visit,
    candidates: Iterable[tuple[float, float, float]],
    known: Container[Screening] = (),
) -> dict[Screening, Floats]:
    """Return the lines' log-likelihoods for candidates (exposure, row time, response; ns) not yet known."""
    chosen = {
        Screening(Shutter(float(exposure), float(row)), response) for exposure, row, response in candidates
    }
    return {
        screening: visit.line_scores(screening)
        for screening in sorted(chosen, key=str)
        if screening not in known
    }


def _beside(response_ns: float) -> tuple[float, ...]:
    place = RESPONSES_NS.index(response_ns)
    return RESPONSES_NS[max(0, place - 1) : place + 2]


def _readings(visit: Visit, alike: PanelTime, found: Mapping[Screening, Floats]) -> Iterator[TrackReading]:
    """Yield the frames' readings: the mean of all lines, weighted by their likelihoods."""
    best = max(float(scores.max()) for scores in found.values())
    chances = np.sum([np.exp(scores - best) for scores in found.values()], axis=0)
    of_step, of_rate = chances.sum(0) / chances.sum(), chances.sum(1) / chances.sum()
    step_ns, rate = float(of_step @ visit.steps_ns), float(of_rate @ visit.rates)
    step_sd_ns = float(np.sqrt(of_step @ (visit.steps_ns - step_ns) ** 2))
    rate_sd = float(np.sqrt(of_rate @ (visit.rates - rate) ** 2))
    later_ns = visit.own_ns - visit.middle_ns
    sd_ns = max(step_sd_ns, rate_sd * float(later_ns.std())) * len(later_ns) ** 0.5
    shutter = max(found, key=lambda of: float(found[of].max())).shutter
    for frame, at_ns in zip(visit.frames, visit.base_ns + step_ns + rate * later_ns, strict=True):
        read = replace(
            alike,
            middle_ns=float(at_ns) % alike.panel.cycle_ns,
            uncertainty_ns=SIGMAS_95 * sd_ns,
            row=frame.middle_row,
            shutter=shutter,
            row_time_error_ns=0.0,
            cycle=frame.cycle,
        )
        yield TrackReading(frame.own_s, read, frame.middle_row)
