"""Steps whose place crossings leave open are placed by the motion in each camera's own images."""

from itertools import pairwise

import numpy as np
import pytest

from reconstruction.time_offsets.frame_jumps import image_change, place_step
from reconstruction.time_offsets.instant_votes import Step

CHANGES = np.random.default_rng(5).uniform(0.1, 1.0, 60)


def seen_by(frames: list[int]) -> dict[int, float]:
    """The changes of a camera whose image k shows the frame with this number."""
    return {
        k: float(CHANGES[before + 1 : now + 1].sum()) for k, (before, now) in enumerate(pairwise(frames), 1)
    }


def at(instant: int, frames: int, low: int, high: int) -> Step:
    return Step(instant=instant, frames=frames, earliest=low, latest=high)


ALL = list(range(40))
DROPPED, TWO_DROPPED = [*ALL[:20], *ALL[21:]], [*ALL[:20], *ALL[22:]]
REPEATED = [*ALL[:20], 19, *ALL[20:]]


@pytest.mark.parametrize(("frames", "by"), [(DROPPED, 1), (TWO_DROPPED, 2), (REPEATED, -1)])
@pytest.mark.parametrize("guess", [18, 20, 25])
def test_a_step_moves_to_where_the_images_changes_fit(frames: list[int], by: int, guess: int) -> None:
    # The second camera's images are half as bright.
    second = {k: 0.5 * change for k, change in seen_by(frames).items()}
    placed = place_step(at(guess, by, 17, 25), seen_by(ALL), second)
    assert placed == at(20, by, 17, 25)


@pytest.mark.parametrize(("low", "high"), [(21, 23), (22, 22), (17, 18), (18, 19)])
def test_a_place_just_outside_the_range_is_found_and_widens_it(low: int, high: int) -> None:
    placed = place_step(at(high, 1, low, high), seen_by(ALL), seen_by(DROPPED))
    assert placed == at(20, 1, min(low, 20), max(high, 20))


def test_a_place_outside_the_range_must_fit_much_better() -> None:
    """Changes like those of a drop at 22, and a little less like those of one at 20."""
    both = seen_by(DROPPED), seen_by([*ALL[:22], *ALL[23:]])
    second = {k: 0.45 * both[0][k] + 0.55 * both[1][k] for k in both[0]}
    for low, high, place in ((19, 22, 22), (19, 20, 20)):
        assert place_step(at(19, 1, low, high), seen_by(ALL), second).instant == place


def test_an_earlier_step_shifts_the_frames_of_the_next() -> None:
    twice = [*ALL[:8], *ALL[9:21], *ALL[22:]]
    # The frames 8 and 21 are gone: instants 8 and 20.
    for step, shift in ((at(10, 1, 6, 11), 0), (at(17, 1, 16, 23), 1)):
        placed = place_step(step, seen_by(ALL), seen_by(twice), shift)
        assert placed.instant == (20 if shift else 8)
    assert place_step(at(17, 1, 16, 23), seen_by(ALL), seen_by(twice), 0).instant != 20


def test_a_step_stays_where_nothing_moves_or_too_little_is_known() -> None:
    step = at(23, 1, 17, 25)
    still = dict.fromkeys(range(40), 0.0)
    assert place_step(step, still, still) == step
    few = {k: change for k, change in seen_by(DROPPED).items() if k > 25}
    assert place_step(step, seen_by(ALL), few) == step
    assert place_step(step, {}, seen_by(DROPPED)) == step


@pytest.mark.parametrize("by", [4, 1, -1])
def test_a_step_that_the_images_do_not_show_is_none(by: int) -> None:
    # As two discs do that turn with different periods.
    assert place_step(at(20, by, 17, 25), seen_by(ALL), seen_by(ALL)).frames == 0


def test_images_change_by_what_moves_and_not_by_noise() -> None:
    rng = np.random.default_rng(1)

    def image(left: int) -> np.ndarray:
        shown = np.full((60, 90), 90.0)
        shown[20:40, left : left + 20] = 200
        return np.clip(shown + rng.normal(0, 3, shown.shape), 0, 255).astype(np.uint8)

    still, moved, twice = (image_change(image(10), image(10 + by)) for by in (0, 5, 10))
    assert still < 0.1
    assert moved > 10 * still
    assert 1.5 * moved < twice < 2.5 * moved
