"""Recordings that nothing synchronized are aligned by a panel, within their bars, or it is said why not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.panel.photographs import draw_corners
from benchmarks.panel.recorded_takes import HEIGHT, WIDTH
from benchmarks.simulated.panel_photographs import HandheldPhotograph
from capture_app.common.errors import BadInputError
from capture_app.companions.panel.cycle_code import Cycle
from capture_app.companions.panel.finder import panels_seen
from capture_app.companions.panel.light_model import Shutter
from capture_app.companions.panel.panel_alignment import match_panels
from capture_app.companions.panel.panel_track import NO_CYCLE, PanelTrack, TrackReading, make_track
from capture_app.companions.panel.pattern import PANELS
from capture_app.companions.panel.time_reading import PanelTime
from capture_app.session.format.common_times import CameraTimes

SCREEN = PANELS["screen-60hz-down"]
SD_S = 5e-4
SLOW_SCREEN = 0.999
"""Rate of a screen of 59.94 Hz against its nominal one."""


def track(start_s: float, ppm: float, visits_s: tuple[float, ...], seed: int) -> PanelTrack:
    """What a camera that begins at a true time reads, 16 times in each visit of a second."""
    rng = np.random.default_rng(seed)
    true_s = np.concatenate([at + np.linspace(0, 1, 16) for at in visits_s])
    return PanelTrack(
        SCREEN,
        7,
        (true_s - start_s) * (1 + ppm * 1e-6),
        true_s * SLOW_SCREEN + rng.normal(0, SD_S, len(true_s)),
        np.full(len(true_s), SD_S),
        np.repeat(np.arange(len(visits_s)), 16),
    )


def error_and_bar_s(times: CameraTimes, true_s: float, start_s: float, ppm: float) -> tuple[float, float]:
    """How wrong a camera's time is against a reference that begins at 0 with the true rate."""
    own_ns = round((true_s - start_s) * (1 + ppm * 1e-6) * 1e9)
    return times.leader_from_local(own_ns) / 1e9 - true_s, (times.uncertainty_at_ns(own_ns) or 0) / 1e9


@pytest.mark.parametrize("carried_s", [0.0, 8.0])
@pytest.mark.parametrize("visits_s", [(100.0,), (100.0, 700.0)])
def test_offset_and_rate_are_within_their_bars(visits_s: tuple[float, ...], carried_s: float) -> None:
    inside = total = 0
    for seed in range(20):
        start_s, ppm = 31.25 + seed, -35.0 + 3 * seed
        reference = track(0.0, 0.0, visits_s, seed)
        times = match_panels(
            reference, track(start_s, ppm, tuple(at + carried_s for at in visits_s), 100 + seed)
        )
        assert times.source == "panel"
        for at in visits_s:
            error_s, bar_s = error_and_bar_s(times, at, start_s, ppm)
            inside, total = inside + (abs(error_s) <= bar_s), total + 1
            if len(visits_s) > 1:
                assert bar_s < 2.5e-3
        if len(visits_s) > 1:
            assert abs(times.rate_ppm + ppm) <= 2 * (times.rate_uncertainty_ppm or 0)
    assert inside >= 0.9 * total


def test_a_missed_refresh_does_no_harm() -> None:
    reference, camera = track(0.0, 0.0, (100.0, 700.0), 1), track(20.0, 10.0, (100.0, 700.0), 2)
    camera.shown_s[[3, 20]] -= SCREEN.tick_ns / 1e9
    error_s, bar_s = error_and_bar_s(match_panels(reference, camera), 400.0, 20.0, 10.0)
    assert abs(error_s) < min(bar_s, 1e-3)


def test_different_pages_are_not_compared() -> None:
    one = track(0.0, 0.0, (100.0,), 1)
    for other in (replace(one, page=8), replace(one, panel=PANELS["screen-120hz-down"])):
        times = match_panels(one, other)
        assert times.offset_ns is None
        assert "they saw different panels" in times.reason


def reading(own_s: float, shown_s: float, **fields: Any) -> TrackReading:
    cycle_s = SCREEN.cycle_ns / 1e9
    values: dict[str, Any] = {
        "panel": SCREEN,
        "middle_ns": shown_s % cycle_s * 1e9,
        "uncertainty_ns": 1e6,
        "row": 100.0,
        "shutter": Shutter(8e6, 0.0),
        "row_time_error_ns": 0.0,
        "markers": 4,
        "residual": 1.0,
        "cycle": Cycle(int(shown_s / cycle_s), 5),
    }
    return TrackReading(own_s, PanelTime(**(values | fields)), 100.0)


def test_readings_across_a_turn_are_unwrapped_and_a_misread_code_is_outvoted() -> None:
    cycle_s = SCREEN.cycle_ns / 1e9
    shown_s = 7 * cycle_s - 0.5 + np.linspace(0, 1, 9)
    seen = [reading(50 + k / 8, at) for k, at in enumerate(shown_s)]
    seen[2] = reading(seen[2].own_s, shown_s[2], cycle=Cycle(900, 5))
    seen[5] = reading(seen[5].own_s, shown_s[5], cycle=None)
    # Exposed while the code changed to the next cycle, before the reading's own middle did.
    seen[3] = reading(seen[3].own_s, shown_s[3], cycle=Cycle(7, 5))
    found = make_track(seen)
    assert found.page == 5
    assert found.shown_s == pytest.approx(shown_s, abs=1e-6)


def test_a_track_says_what_it_lacks() -> None:
    with pytest.raises(BadInputError, match=NO_CYCLE.split(":", maxsplit=1)[0]):
        make_track([reading(0, 5, cycle=None)])
    other = reading(1, 6, panel=PANELS["screen-75hz-up"])
    with pytest.raises(BadInputError, match="several panels, screen-60hz-down and screen-75hz-up"):
        make_track([reading(0, 5), other])
    pages = [reading(k, 5 + k, cycle=Cycle(0, k % 2)) for k in range(10)]
    with pytest.raises(BadInputError, match="loaded again"):
        make_track(pages)


def photograph(cycle: Cycle | None = None, **fields: Any) -> HandheldPhotograph:
    corners = draw_corners(SCREEN, np.random.default_rng(5), WIDTH, HEIGHT, oblique=False)
    return HandheldPhotograph(
        SCREEN, WIDTH, HEIGHT, corners, 10e6, 15e3, defocus=0.6, jpeg_quality=None, cycle=cycle, **fields
    )


def test_two_panels_in_one_image_are_seen_as_two() -> None:
    rng = np.random.default_rng(2)
    one = photograph().take(1e9, rng)
    other = replace(photograph(), panel=PANELS["screen-144hz-down"]).take(1e9, rng)
    assert panels_seen(one[..., 1]) == ["screen-60hz-down"]
    assert panels_seen(np.hstack([one, other])[..., 1]) == ["screen-144hz-down", "screen-60hz-down"]
    assert panels_seen(np.hstack([one, one])[..., 1]) == ["screen-60hz-down"] * 2
    assert panels_seen(np.full((200, 300), 90, np.uint8)) == []
