"""Sound of images: which samples an image carries, and their times, whatever the microphone's clock does."""

from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.cameras.frames import JpegPicture
from capture_app.plugins.cameras.sound.image_sound import (
    SoundPart,
    add_segments,
    sound_segments,
    sounds_of,
)
from capture_app.plugins.cameras.sound.sound_camera import SoundPicture
from capture_app.plugins.cameras.sound.sound_ring import MAX_LATE, RATE_HZ, SoundRing
from capture_app.session.reading.decoding import decode_image, is_whole_jpeg, read_exif, size_of
from tests.unit.plugins.cameras.sound.arrivals import BEGIN_NS, DELAY_NS, arrivals
from tests.unit.plugins.programs.clicks import click_errors_ms

SECOND_NS = 1_000_000_000
PIXELS = np.random.default_rng(1).integers(0, 255, (48, 64, 3), np.uint8)
JPEG = cv2.imencode(".jpg", PIXELS)[1].tobytes()
EXIF = b"\xff\xe1\x00\x22Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"


def filled(length_s: float = 4.0, **different: Any) -> SoundRing:
    ring = SoundRing()
    for pcm, arrival_ns in arrivals(length_s, **different):
        ring.add(pcm, arrival_ns)
    return ring


def carried(ring: SoundRing, after_s: float) -> list[SoundPart]:
    """What the image carries that is taken so long after the sound's begin."""
    data = ring.carry(BEGIN_NS + round(after_s * 1e9))
    return sounds_of(b"\xff\xd8" + data + JPEG[2:])


def span(parts: list[SoundPart]) -> tuple[int, int]:
    """First sample and the one after the last; the parts follow each other."""
    for before, after in pairwise(parts):
        assert before.first + before.samples == after.first
    return parts[0].first, parts[-1].first + parts[-1].samples


def carried_at_once(heard: Iterable[tuple[bytes, int]]) -> list[SoundPart]:
    """What images carry that are taken and encoded as each part of the sound arrives."""
    ring, parts = SoundRing(), []
    for pcm, arrival_ns in heard:
        ring.add(pcm, arrival_ns)
        parts += sounds_of(b"\xff\xd8" + ring.carry(arrival_ns) + JPEG[2:])
    return parts


def test_an_image_with_sound_is_the_same_image_to_all_readers() -> None:
    parts = [
        SoundPart(7, 100, RATE_HZ, 1, -5, b"\xff\xd9\xff\xd8" * 10),
        SoundPart(7, 120, 16_000, 2, 1, bytes(8)),
    ]
    exif = JPEG[:2] + EXIF + JPEG[2:]
    made = add_segments(exif, sound_segments(parts))
    assert sounds_of(made) == parts
    assert read_exif(made).orientation == 6
    assert made.startswith(JPEG[:2] + EXIF)
    assert size_of(made) == (64, 48)
    assert is_whole_jpeg(made)
    assert not is_whole_jpeg(made[:-200])
    assert (decode_image(made, colour=True) == decode_image(JPEG, colour=True)).all()
    png = cv2.imencode(".png", PIXELS)[1].tobytes()
    assert add_segments(png, sound_segments(parts)) == png


@pytest.mark.parametrize("wrong", [{"rate_hz": 0}, {"channels": 3}, {"first": 2**60}, {"pcm": b""}])
def test_sound_that_cannot_be_is_skipped(wrong: dict[str, Any]) -> None:
    right = SoundPart(7, 0, RATE_HZ, 1, 0, bytes(4))
    short = b"\xff\xe9\x00\x14" + sound_segments([right])[4:22]
    made = add_segments(JPEG, short + sound_segments([right._replace(**wrong), right]))
    assert sounds_of(made) == [right]
    for cut in range(100):
        assert sounds_of(made[:cut]) in ([], [right])


def test_images_carry_all_sound_once_and_at_most_a_second() -> None:
    ring = filled()
    # The first image carries a second; the frame at 2.6 s was dropped; the last one is newer than the sound.
    spans = [span(carried(ring, after_s)) for after_s in (2.4, 2.5, 2.7, 9.0)]
    assert spans[0][1] - spans[0][0] == RATE_HZ
    assert [spans[1][0], spans[2][0], spans[3][0]] == [spans[0][1], spans[1][1], spans[3][1] - RATE_HZ]
    assert spans[2][1] - spans[2][0] == pytest.approx(0.2 * RATE_HZ, abs=2)
    assert spans[0][1] == pytest.approx((2.4 - DELAY_NS / 1e9) * RATE_HZ, abs=20)


def test_an_image_that_is_encoded_late_carries_the_sound_before_it() -> None:
    ring = filled()
    carried(ring, 2.0)
    later, earlier = span(carried(ring, 2.2)), span(carried(ring, 2.1))
    assert earlier[0] == later[0]
    assert span(carried(ring, 2.3))[0] == later[1]


def test_an_image_is_the_same_each_time_it_is_encoded() -> None:
    ring = filled()
    picture = SoundPicture(JpegPicture(JPEG), BEGIN_NS + 2 * SECOND_NS, ring)
    first = picture.encode()
    assert len(first) > len(JPEG) + 2 * RATE_HZ
    SoundPicture(JpegPicture(JPEG), BEGIN_NS + round(1.9e9), ring).encode()
    assert picture.encode() == first


def test_a_delay_is_no_gap() -> None:
    ring = filled(8.0, stalls_s=((3.0, 3.6), (5.0, 5.9)))
    parts = [part for tenth in range(10, 79) for part in carried(ring, tenth / 10)]
    errors_ms = click_errors_ms(parts)
    assert len(errors_ms) == 8
    assert errors_ms == pytest.approx([DELAY_NS / 1e6] * 8, abs=1.0)


@pytest.mark.parametrize("seed", range(3))
def test_after_an_overrun_all_is_in_step_and_the_gap_is_silence(seed: int) -> None:
    ring = filled(12.0, lost_s=(4.5, 4.9), seed=seed)
    parts = [part for tenth in range(10, 119) for part in carried(ring, tenth / 10)]
    assert len({part.stream for part in parts}) == 1
    errors_ms = click_errors_ms(parts)
    assert len(errors_ms) == 11
    assert errors_ms == pytest.approx([DELAY_NS / 1e6] * 11, abs=2.0)
    assert span(parts)[1] == pytest.approx(11.8 * RATE_HZ, abs=0.003 * RATE_HZ)


def test_sound_that_waits_for_the_decision_is_not_carried_at_a_wrong_time() -> None:
    errors_ms = click_errors_ms(carried_at_once(arrivals(12.0, lost_s=(4.5, 4.9))))
    assert len(errors_ms) == 11
    assert errors_ms == pytest.approx([DELAY_NS / 1e6] * 11, abs=2.0)


def test_a_microphone_that_starts_again_begins_a_stream() -> None:
    ring = filled(2.0)
    before = carried(ring, 1.5)[0].stream
    ring.begin_stream()
    assert carried(ring, 1.6) == []
    for pcm, arrival_ns in arrivals(2.0, begin_ns=BEGIN_NS + 5 * SECOND_NS):
        ring.add(pcm, arrival_ns)
    parts = carried(ring, 6.5)
    assert parts[0].stream != before
    assert click_errors_ms(parts) == pytest.approx([DELAY_NS / 1e6], abs=1.0)


def test_samples_that_were_read_late_are_placed_before_the_gap_after_them() -> None:
    """The program stands still for a second; the pipe holds the first 0.6 s, and the rest is lost."""
    ring = filled(12.0, stalls_s=((4.4, 5.4),), lost_s=(5.0, 5.4))
    errors_ms = click_errors_ms([part for tenth in range(10, 119) for part in carried(ring, tenth / 10)])
    assert len(errors_ms) == 12
    assert errors_ms == pytest.approx([DELAY_NS / 1e6] * 12, abs=2.0)


@pytest.mark.parametrize("stall_s", [0.15, 0.3])
def test_a_delay_that_ends_just_before_a_gap_does_not_shorten_it(stall_s: float) -> None:
    """What was read 70 ms late before the loss made a gap of 70 ms out of 250, and a second one later."""
    stall = (4.07 - stall_s, 4.07)
    parts = carried_at_once(arrivals(12.0, stalls_s=(stall,), lost_s=(4.0, 4.25)))
    errors_ms = click_errors_ms(parts)
    assert len(errors_ms) == 12
    assert errors_ms == pytest.approx([DELAY_NS / 1e6] * 12, abs=2.0)


def test_a_long_delay_that_was_taken_for_a_loss_is_over_when_samples_are_in_time_again() -> None:
    parts = carried_at_once(
        (pcm, at_ns + 100_000_000 * (4.0 <= (at_ns - BEGIN_NS) / 1e9 < 6.0)) for pcm, at_ns in arrivals(12.0)
    )
    assert len({part.stream for part in parts}) == 2
    errors_ms = click_errors_ms([part for part in parts if part.stream == parts[-1].stream])
    assert len(errors_ms) == 6
    assert errors_ms == pytest.approx([DELAY_NS / 1e6] * 6, abs=2.0)


def test_what_a_phone_with_a_broken_clock_sends_takes_little_memory() -> None:
    ring = filled(2.0)
    for _ in range(3 * MAX_LATE):
        ring.add(bytes(2), BEGIN_NS + 9 * SECOND_NS)
    assert len(ring._late) <= MAX_LATE
