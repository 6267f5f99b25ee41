"""A camera that loses frames with their sound is told from one whose clock drifts."""

import numpy as np
import pytest

from capture_app.plugins.footage.sound import RATE_HZ, find_jump, match_sounds

AT_S = np.linspace(1, 40, 20)


def offsets(jump_s: float, place: int = 12, ppm: float = 0.0) -> np.ndarray:
    noise = np.random.default_rng(0).normal(0, 5e-5, len(AT_S))
    return 1.25 + np.where(np.arange(len(AT_S)) < place, 0, jump_s) + 1e-6 * ppm * AT_S + noise


@pytest.mark.parametrize("jump_s", [0.0167, -0.0333, 0.06])
def test_a_jump_is_found_and_placed(jump_s: float) -> None:
    jump = find_jump(AT_S, offsets(jump_s, ppm=20))
    assert jump is not None
    assert jump.by_s == pytest.approx(jump_s, abs=0.001)
    assert (jump.after_s, jump.before_s) == (AT_S[11], AT_S[12])
    assert ("the other camera loses" in str(jump)) == (jump_s < 0)
    assert f"{abs(1000 * jump.by_s):.0f} ms" in str(jump)


@pytest.mark.parametrize(("jump_s", "ppm"), [(0.0, 0.0), (0.0, 300.0), (0.003, 0.0)])
def test_a_drift_is_no_jump(jump_s: float, ppm: float) -> None:
    assert find_jump(AT_S, offsets(jump_s, ppm=ppm)) is None


def test_two_windows_on_a_side_are_too_few() -> None:
    assert find_jump(AT_S, offsets(0.033, place=18)) is None
    assert find_jump(AT_S[:5], offsets(0.033, place=3)[:5]) is None


def test_lost_sound_widens_the_error_bar() -> None:
    rng = np.random.default_rng(3)
    loud = np.repeat(rng.random(200) ** 4, RATE_HZ // 10)
    whole = (loud * rng.normal(0, 0.3, len(loud))).astype(np.float32)
    at, lost = 12 * RATE_HZ, RATE_HZ // 30
    cut = np.concatenate([whole[:at], whole[at + lost :]])
    same, jumped = (match_sounds((whole, 0.0), (one, 0.0), 0.001) for one in (whole, cut))
    assert same.reason == ""
    assert (same.uncertainty_ns or 0) < 2_000_000
    assert "it loses 33 ms of sound" in jumped.reason
    assert (jumped.uncertainty_ns or 0) > 33_000_000
