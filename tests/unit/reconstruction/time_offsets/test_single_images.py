"""Single images that are off, repeated, or show nothing are named, with their instants."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from capture_app.session.format.common_times import REFERENCE
from reconstruction.common.geometry import Array
from reconstruction.common.templates import render_lines
from reconstruction.method.timing import Timing, judge_timing, with_curve_peak, with_repeats
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.camera_time import CameraTime
from reconstruction.time_offsets.crossings import Crossings, OffsetFit, fit_offset
from reconstruction.time_offsets.rig_offsets import adjust_offsets, with_changes
from reconstruction.time_offsets.session_offsets import TimeResult
from reconstruction.time_offsets.single_images import SingleImages, repeated_images, stalled_images
from tests.unit.reconstruction.test_timing import timing_sentences
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


def odd_image(instant: int, frames: float) -> Crossings:
    """Sixty crossings of one image of R that agree on an offset of its own."""
    count = 60
    few = take().only(np.arange(count))
    return replace(
        few,
        instant=np.full(count, instant),
        in_second=np.full(count, instant),
        offset_ms=np.full(count, frames * PERIOD_MS),
        across_px_per_ms=np.full(count, 0.5),
        counts=np.ones(count),
    )


def test_an_image_beside_dropped_frames_is_no_glitch() -> None:
    """The path over the gap told "15 ms later at 7" of a camera that dropped its seventh frame."""
    for instant, glitches in ((12, []), (5, [5])):
        found = fit_offset(
            Crossings.join([take((12, 1)), odd_image(instant, 0.5 + (instant >= 12))]),
            NOTHING_STILL,
            PERIOD_MS,
        )
        assert [(step.instant, step.frames) for step in found.change.steps] == [(12, 1)]
        assert [*found.glitches_ms[1]] == glitches


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


class Film:
    """Images of two cameras before which a square moves; each image shows the moment that is given."""

    def __init__(self, **moments: Sequence[float]) -> None:
        self.moments = moments

    def instants(self, camera: str) -> tuple[int, ...]:
        return tuple(range(len(self.moments[camera])))

    def has_image(self, camera: str, instant: int) -> bool:
        return instant in self.instants(camera)

    def grey(self, camera: str, instant: int) -> Array:
        image = np.full((60, 160), 90.0)
        at = round(10 + 4 * self.moments[camera][instant])
        image[20:40, at : at + 20] = 200.0
        noise = np.random.default_rng([instant, len(camera)]).normal(0, 2, image.shape)
        return (image + noise).clip(0, 255).astype(np.uint8)

    def stalled(self) -> dict[str, tuple[int, ...]]:
        return stalled_images(cast(Dataset, self), [*self.moments])


STEADY = [float(k) for k in range(24)]


def test_an_image_of_its_neighbours_moment_is_named() -> None:
    """One a frame late shows what the next one shows; one compressed anew what the one before shows."""
    late, again = STEADY.copy(), STEADY.copy()
    for k in (5, 9, 14):
        late[k], again[k] = k + 1.0, k - 1.0
    assert Film(left=STEADY, right=late).stalled() == {"left": (), "right": (6, 10, 15)}
    assert Film(left=STEADY, right=again).stalled() == {"left": (), "right": (5, 9, 14)}
    half = [k + 0.5 * (k in (5, 9, 14)) for k in STEADY]
    assert Film(left=STEADY, right=half).stalled() == {"left": (), "right": ()}


def test_where_nothing_moves_or_moves_no_more_no_image_is_stalled() -> None:
    rest = [min(k, 12.0) for k in STEADY]
    pause = [k if k < 8 else 8.0 if k < 11 else k - 3 for k in STEADY]
    for moments in (rest, pause, [3.0] * 24):
        assert Film(left=moments, right=moments).stalled() == {"left": (), "right": ()}
    # The thing has left one camera's view.
    assert Film(left=STEADY, right=rest).stalled() == {"left": (), "right": ()}


def test_an_image_that_all_cameras_repeat_is_not_a_repeated_frame() -> None:
    digests = {"left": "aabcd", "right": "aabbc"}
    dataset = SimpleNamespace(
        cameras=("left", "right"),
        instants=lambda camera: range(5),
        record=lambda camera, k: SimpleNamespace(sha256=digests[camera][k]),
    )
    assert repeated_images(cast(Dataset, dataset), "right") == (3,)


def test_a_take_that_shows_moments_twice_is_not_certified() -> None:
    sure = judge_timing(PAIR, fitted({}), 0.0, PERIOD_MS)
    nothing: dict[str, tuple[int, ...]] = {"L": (), "R": ()}
    assert with_repeats(sure, nothing, nothing) == sure
    assert sure.synchronized
    for stalled in ({"L": (), "R": (6, 10)}, {"L": (4,), "R": ()}):
        timing = with_repeats(sure, nothing, stalled)
        assert not timing.synchronized
        assert timing.same_frame_ms is None
        assert not timing.offset
        # Nor by the depth that most images have together.
        assert with_curve_peak(timing, dict.fromkeys(range(4), 0.0), PERIOD_MS) == timing
    assert with_curve_peak(sure, dict.fromkeys(range(4), 0.0), PERIOD_MS).same_frame_ms is not None
    text = timing_sentences(with_repeats(sure, nothing, {"L": (), "R": (6, 10)}))
    assert "R's images at 6, 10 show the moment of the image before" in text


def test_a_planned_delay_is_said_beside_what_is_beyond_it() -> None:
    cameras = {
        "L": CameraTime(offset_ms=0.0, sd_ms=0.0, source=REFERENCE),
        "R": CameraTime(offset_ms=0.12, sd_ms=0.3, source="motion", planned_ms=25.0),
    }
    result = TimeResult(session="s", reference="L", cameras=cameras, calibration="", seconds=1.0)
    assert render_lines("times.txt", "reconstruction.commands", result=result) == [
        "L: the reference",
        "R: +0.12 ± 0.60 ms (95 %), beyond the +25.00 ms by which it is staggered on purpose",
    ]


def test_instants_are_named_up_to_eight() -> None:
    images = SingleImages(repeated=tuple(range(3, 15)), period_ms=33.0)
    (text,) = images.describe("R", "L")
    named = "3, 4, 5, 6, 7, 8, 9, 10 and 4 more"
    assert text == f"R repeats 12 images, at {named}: the same bytes as the image before"
    mixed = SingleImages(glitches_ms={3: -66.0, 5: 14.0, 9: -65.0}, examined=12, period_ms=33.0)
    assert [*mixed.describe("R", "L")] == [
        "R differs from L at 3 of 12 instants: 2 frames earlier at 3, 9; 14 ms later at 5"
    ]


HALF_LATE = dict.fromkeys((0, 1, 2, *range(9, 20), 21, 22), 0.25)
"""Sixteen of 24 instants a quarter of a frame late, most of them in a row, as jitter is not."""


def times_said(fit: OffsetFit) -> list[str]:
    """What `reconstruct time` says of a pair."""
    measured = {PAIR: fit}
    cameras = with_changes(adjust_offsets("LR", "L", measured), measured, PERIOD_MS)
    result = TimeResult(session="s", reference="L", cameras=cameras, calibration="", seconds=1.0)
    return [*render_lines("times.txt", "reconstruction.commands", result=result)]


def test_an_offset_of_half_of_the_instants_is_not_called_one() -> None:
    """`+13.65 ± 2.55 ms` was all that was said."""
    fit = fitted(HALF_LATE)
    assert fit.jitter_ms(PERIOD_MS) is None
    assert times_said(fit)[2] == (
        "R's offset is not one: 8 of 32 instants differ from it, by -4.5 to -4.0 ms; its frames come "
        "unevenly, or the calibration is wrong"
    )
    steady, dropped = fitted({}), fitted(dict.fromkeys(range(12, 24), 1.0))
    assert dropped.change
    assert not any("is not one" in line for fit in (steady, dropped) for line in times_said(fit))


@pytest.mark.parametrize(
    ("ms", "said"),
    [(5.0, "5 ms later"), (-9.0, "9 ms earlier"), (30.0, "1 frame later"), (-70.0, "2 frames earlier")],
)
def test_an_image_is_so_many_frames_late_or_a_part_of_one(ms: float, said: str) -> None:
    (text,) = SingleImages(glitches_ms={3: ms}, period_ms=33.0).describe("R", "L")
    assert said in text, text
