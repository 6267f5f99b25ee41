"""Many people in one picture, and people who hide each other."""

import numpy as np
import pytest

from benchmarks.people.figure import moving
from benchmarks.people.scenes import draw_take, locate_people
from benchmarks.people.scores import score
from tests.unit.reconstruction.methods.people.takes import TIMES_S, errors_mm, finder, take


def test_twenty_people_are_twenty() -> None:
    crowd = [moving("walk", (0.8 * (k % 5) - 1.6, 0.8 * (k // 5) - 1.2), phase=0.7 * k) for k in range(20)]
    at = TIMES_S[2:5]
    found = finder(take(crowd, 3, noise_px=1.5, times_s=TIMES_S[:7])).at(at)
    nearest = [
        int(np.argmin([np.nanmedian(errors_mm(one.positions, who, at)) for who in crowd]))
        for one in found.people
    ]
    assert sorted(nearest) == list(range(20))


@pytest.mark.parametrize(("kind", "seed"), [("crossing", 23), ("embrace", 20)])
def test_who_was_hidden_is_the_same_as_before(kind: str, seed: int) -> None:
    scene = draw_take(kind, 3, seed)
    scores = score(scene.truth, scene.visible, locate_people(scene))
    assert (scores.takes_right, scores.changes) == (1, 0)
