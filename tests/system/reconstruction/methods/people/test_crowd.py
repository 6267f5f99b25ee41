"""Many people in one picture."""

import numpy as np

from benchmarks.people.figure import moving
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
