"""Islands of a view's depth."""

import numpy as np

from reconstruction.depth.geometric_consistency import remove_speckles


def test_speckles_go_and_large_islands_stay() -> None:
    good = np.zeros((40, 40), bool)
    good[2:5, 2:5] = good[10:35, 10:35] = True
    kept = remove_speckles(good, np.full((40, 40), 0.4, np.float32), 50)
    assert not kept[3, 3]
    assert kept[20, 20]
    assert not remove_speckles(np.zeros((4, 4), bool), np.ones((4, 4)), 5).any()
