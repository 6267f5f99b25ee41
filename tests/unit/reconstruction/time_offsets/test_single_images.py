"""Single images that are off, repeated, or show nothing are named, with their instants."""

import numpy as np
import pytest

from reconstruction.method.timing import Timing, judge_timing
from reconstruction.report.findings import timing_sentences
from reconstruction.time_offsets.crossings import OffsetFit, fit_offset
from reconstruction.time_offsets.rig_offsets import adjust_offsets, with_changes
from reconstruction.time_offsets.single_images import SingleImages
from tests.unit.reconstruction.time_offsets.test_instant_votes import INSTANTS, take
from tests.unit.reconstruction.time_offsets.test_offset_fit import NOTHING_STILL, PERIOD_MS

PAIR = ("L", "R")


def fitted(late_frames: dict[int, float]) -> OffsetFit:
    """A take on time, but for these instants."""
    found = take(points=60)
    late_ms = np.array([PERIOD_MS * late_frames.get(int(k), 0.0) for k in found.instant])
    return fit_offset(found.later(late_ms), NOTHING_STILL, PERIOD_MS).examined_at(range(INSTANTS + 8))


def judged(fit: OffsetFit) -> Timing:
    return judge_timing(PAIR, fit, 0.0, PERIOD_MS)


def test_single_images_a_frame_late_are_named_with_their_instants() -> None:
    timing = judged(fitted({6: 1.0, 14: 1.0}))
    assert [*timing.images.glitches_ms] == [6, 14]
    assert not timing.synchronized
    text = timing_sentences(timing)
    assert "R differs from L at 2 of 32 instants: 1 frame later at 6, 14." in text
    assert "8 of 32 instants do not show R's offset" in text
    assert "at 24, 25, 26, 27, 28, 29, 30, 31." in text


@pytest.mark.parametrize("frames", [0.5, 1.0])
def test_images_that_are_often_late_jitter(frames: float) -> None:
    """Of 24 instants 8 half a frame or a frame late: `1.4 ± 0.9 ms later` said nothing of it."""
    late = dict.fromkeys((1, 4, 7, 9, 12, 15, 18, 21), frames)
    timing = judged(fitted(late))
    true_ms = float(np.std([late.get(k, 0.0) * PERIOD_MS for k in range(INSTANTS)]))
    assert timing.jitter_ms == pytest.approx(true_ms, rel=0.2)
    assert timing.offset
    assert "R's frames wander by ±" in timing_sentences(timing)


def test_a_steady_take_has_no_glitch() -> None:
    for seed in range(4):
        fit = fit_offset(take(seed=seed), NOTHING_STILL, PERIOD_MS)
        assert fit.glitches_ms == ({}, {})
        assert fit.jitter_ms(PERIOD_MS) is None


def test_a_glitch_is_of_the_camera_that_has_it_in_all_pairs() -> None:
    odd = {7: 33.0}
    beside = {8: -16.0}
    measured = {
        ("a", "b"): OffsetFit(0.0, 0.5, glitches_ms=(beside, odd)),
        ("a", "c"): OffsetFit(0.0, 0.5),
        ("b", "c"): OffsetFit(0.0, 0.5, glitches_ms=(odd, {})),
    }
    found = with_changes(adjust_offsets("abc", "a", measured), measured, 33.0)
    assert {name: one.images.glitches_ms for name, one in found.items()} == {"a": {}, "b": odd, "c": {}}
    two = {("a", "b"): OffsetFit(0.0, 0.5, glitches_ms=(beside, odd))}
    found = with_changes(adjust_offsets("ab", "a", two), two, 33.0)
    assert {name: one.images.glitches_ms for name, one in found.items()} == {"a": {}, "b": odd}


def test_instants_are_named_up_to_eight() -> None:
    images = SingleImages(repeated=tuple(range(3, 15)), period_ms=33.0)
    (text,) = images.describe("R", "L")
    named = "3, 4, 5, 6, 7, 8, 9, 10 and 4 more"
    assert text == f"R repeats 12 images, at {named}: the same bytes as the image before"
    mixed = SingleImages(glitches_ms={3: -66.0, 5: 14.0, 9: -65.0}, examined=12, period_ms=33.0)
    assert [*mixed.describe("R", "L")] == [
        "R differs from L at 3 of 12 instants: 2 frames earlier at 3, 9; 14 ms later at 5"
    ]
