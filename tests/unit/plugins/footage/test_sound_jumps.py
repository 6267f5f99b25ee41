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


def test_a_timecode_on_one_channel_does_not_hide_the_room_on_the_other() -> None:
    """A linear timecode is as loud all the time, and other bits for each camera."""
    random = np.random.default_rng(4)
    room = np.zeros(12 * RATE_HZ, np.float32)
    for at_s in (3.1, 4.4, 6.03, 7.9):
        size = RATE_HZ // 20
        decay = np.exp(-np.arange(size) / (0.008 * RATE_HZ))
        room[round(at_s * RATE_HZ) :][:size] += 0.5 * random.standard_normal(size) * decay
    sounds = []
    for begin in (0, round(1.24 * RATE_HZ)):
        heard = room[begin : begin + 9 * RATE_HZ] + random.normal(0, 0.002, 9 * RATE_HZ)
        bits = np.repeat(random.integers(0, 2, 9 * 2000) * 2 - 1, RATE_HZ // 2000)
        sounds.append((np.stack([0.5 * bits, heard]).astype(np.float32), 0.0))
    mixed = [(channels.mean(0), start_s) for channels, start_s in sounds]
    assert match_sounds(mixed[0], mixed[1], 0.001).offset_ns is None
    found = match_sounds(sounds[0], sounds[1], 0.001)
    assert found.offset_ns == pytest.approx(1.24e9, abs=0.2e6)
