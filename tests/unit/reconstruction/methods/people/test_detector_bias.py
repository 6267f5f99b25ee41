"""The bias of a detector in the errors, and where none was measured."""

import numpy as np

from benchmarks.people.figure import moving
from reconstruction.methods.people.detector_bias import BIASES, detector_bias
from reconstruction.methods.people.people_result import _remarks
from reconstruction.methods.people.people_run import PeopleFinder
from reconstruction.methods.people.skeletons import SKELETONS
from tests.unit.reconstruction.methods.people.takes import STEP_S, TIMES_S, take

SKELETON = SKELETONS["blazepose"]


def test_a_joint_without_a_reference_has_the_largest_bias_of_the_others() -> None:
    bias, source = detector_bias(SKELETON)
    assert bias is not None
    assert "Pose2Sim" in source
    assert bias[SKELETON.joints.index("left_ear")] == max(BIASES["blazepose"]["joints"].values())


def test_the_bias_widens_errors_by_the_size_of_a_person() -> None:
    frames = take([moving("walk")], times_s=TIMES_S[:8], noise_px=0.5)
    bias = np.full(len(SKELETON.joints), 0.02)
    without, biased = (PeopleFinder(frames, SKELETON, STEP_S, bias=one) for one in (None, bias))
    (narrow,), (wide,) = (one.at(TIMES_S[2:6]).people for one in (without, biased))
    size_m = 1.7
    assert 2.4 < np.median(np.sqrt(wide.error**2 - narrow.error**2) / (0.02 * size_m)) < 3.4
    assert "precision alone" in _remarks(without)[-1]
    assert _remarks(biased) == ()


def test_of_an_unknown_skeleton_no_bias_was_measured() -> None:
    for name in ("coco_17", "halpe_26"):
        assert detector_bias(SKELETONS[name]) == (None, "")
