"""A camera whose frames are stamped wrongly is named by the joints of who moves; others are not."""

import numpy as np
import pytest

from benchmarks.people.figure import moving, ring, seen_by
from reconstruction.methods.people.joint_times import describe_late_cameras, late_cameras
from reconstruction.methods.people.people_run import CameraFrames, PeopleFinder
from tests.unit.reconstruction.methods.people.takes import STEP_S, TIMES_S, finder

WALK = moving("walk")


def stamped_wrongly(late_s: dict[str, float], cameras: int = 4) -> PeopleFinder:
    """The people of a take in which some cameras took their frames later than these say."""
    rng, frames = np.random.default_rng(5), dict[str, CameraFrames]()
    for k, view in enumerate(ring(cameras, 150)):
        frames[f"cam{k}"] = seen_by(view, [WALK], TIMES_S[:36], rng, late_s=late_s.get(f"cam{k}", 0.0))
    return finder(frames)


@pytest.mark.parametrize(
    "late_s", [{}, {"cam1": STEP_S}, {"cam0": -2 * STEP_S}, {"cam1": 0.05, "cam4": -0.03}]
)
def test_cameras_are_named_with_their_times(late_s: dict[str, float]) -> None:
    found = {one.name: one for one in late_cameras(stamped_wrongly(late_s, 5), TIMES_S[:36])}
    assert found.keys() == late_s.keys()
    for name, one in found.items():
        assert abs(one.late_s - late_s[name]) < 2 * one.error_s + 1e-3
        assert one.error_s < 0.3 * abs(late_s[name])


def test_the_words_say_which_when_and_that_no_error_has_it() -> None:
    (words,) = describe_late_cameras(stamped_wrongly({"cam2": 2 * STEP_S}), TIMES_S[:36])
    assert words.startswith("cam2's joints are where the others see them 3")
    assert " ms later (± " in words
    assert words.endswith("which is in no error")


def test_two_cameras_or_a_short_take_say_nothing() -> None:
    assert not late_cameras(stamped_wrongly({"cam1": 2 * STEP_S}, 2), TIMES_S[:36])
    assert not late_cameras(stamped_wrongly({"cam1": 2 * STEP_S}), TIMES_S[:12])
