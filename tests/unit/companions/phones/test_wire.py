"""What strangers' pages may say, and what is refused."""

import contextlib
import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.companions.phones import wire


@given(st.binary(max_size=80))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    try:
        message = wire.decode_binary(data)
    except ValueError:
        return
    assert isinstance(message, wire.Ping | wire.FrameReport | wire.PictureBytes | wire.SoundReport)


@given(st.text(max_size=80))
def test_any_text_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(ValueError):
        assert isinstance(wire.decode_text(text), wire.PhoneHello | wire.Opened | wire.PageHidden)


@pytest.mark.parametrize("time_us", [math.inf, math.nan, 1e300])
def test_times_that_no_clock_shows_are_refused(time_us: float) -> None:
    with pytest.raises(ValueError, match="out of range"):
        wire.decode_binary(struct.pack("<BIIdd", wire.PING, 1, 0, 0.0, time_us))
    with pytest.raises(ValueError, match="out of range"):
        wire.decode_binary(struct.pack("<BIIddd", wire.FRAME, 1, 0, 0.0, time_us, 0.0))


def test_sound_is_whole_samples_of_about_a_second_at_most() -> None:
    head = struct.pack("<Bd", wire.SOUND, 5.0)
    assert wire.decode_binary(head + bytes(4)) == wire.SoundReport(5.0, bytes(4))
    for wrong in (
        head + bytes(3),
        head + bytes(wire.MAX_SOUND_BYTES),
        struct.pack("<Bd", wire.SOUND, math.nan),
    ):
        with pytest.raises(ValueError, match=r"sound|out of range"):
            wire.decode_binary(wrong)


def test_a_frame_without_a_capture_time() -> None:
    told = wire.decode_binary(struct.pack("<BIIddd", wire.FRAME, 3, 1, 5.0, 6.0, math.nan))
    assert told == wire.FrameReport(3, 1, 5.0, 6.0, None)


@pytest.mark.parametrize(
    "text",
    [
        '{"type": "opened", "width": 0, "height": 480}',
        '{"type": "opened", "width": 640, "height": 480, "frame_rate": -1}',
        '{"type": "hello", "page": "x", "resolution_us": -5}',
        '{"type": "order"}',
    ],
)
def test_nonsense_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        wire.decode_text(text)
