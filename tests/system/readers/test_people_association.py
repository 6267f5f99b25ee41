"""People counted beside Pose2Sim's association of the same detections, in one drawn scene.

`make readers` installs it.
"""

import numpy as np
import pytest

from benchmarks.people.association import (
    POSE2SIM,
    count_people,
    located_by_pose2sim,
    located_by_simulshot,
)
from benchmarks.people.scenes import draw

pytestmark = pytest.mark.filterwarnings("ignore")  # of this program, about what it imports


def test_people_are_counted_right_at_least_as_often_as_by_pose2sim() -> None:
    pytest.importorskip(POSE2SIM, reason="pose2sim is not installed")
    scene = draw("embrace", 4, 2, 0, seconds=2.0)
    theirs = count_people(scene, located_by_pose2sim(scene))
    ours = count_people(scene, located_by_simulshot(scene))
    assert theirs.instants == ours.instants == 60
    assert theirs.right > 30, "its files were read"
    assert ours.right >= theirs.right
    assert ours.missing <= theirs.missing
    assert ours.extra <= theirs.extra


def test_who_is_missing_and_too_many_is_counted() -> None:
    scene = draw("apart", 4, 2, 0, seconds=0.2)
    true = [scene.truth[:, k] for k in range(6)]
    nobody = true[0][:1] + np.array([5.0, 0.0, 0.0])
    counts = count_people(scene, [true[0], true[1][:1], np.concatenate([true[2], nobody]), *true[3:]])
    assert counts == (6, 4, 12, 1, 1)
