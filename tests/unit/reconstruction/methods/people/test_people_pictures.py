"""People drawn into pictures: what is sure as a disc of its error, what is not as a ring."""

import re

import numpy as np

from capture_app.common.walk import SKELETONS
from reconstruction.methods.people.people_pictures import draw_joints
from reconstruction.methods.people.people_run import UNSURE
from reconstruction.methods.people.skeletons import Skeleton
from tests.project import ROOT
from tests.unit.reconstruction.conftest import make_view

VIEW = make_view((0.0, 0.0, 0.0))
PERSON = Skeleton(("head", "foot"), ((0, 1),))


def coloured(error_m: float) -> float:
    """Part of a grey picture that two metres of a person colour, whose head has this error."""
    grey = np.full((VIEW.height, VIEW.width, 3), 128, np.uint8)
    joints = np.array([[0.0, -1.0, 6.0], [0.0, 1.0, 6.0]])
    drawn = draw_joints(grey, VIEW, PERSON, [(0, joints, np.array([error_m, 0.01]))])
    return float((drawn != grey).any(axis=2).mean())


def test_pages_and_pictures_call_the_same_joints_unsure() -> None:
    assert [
        float(number) for number in re.findall(r"UNSURE = ([.\d]+)", SKELETONS.read_text(encoding="utf-8"))
    ] == [UNSURE]
    page = (ROOT / "capture_app/companions/monitor/page/index.html").read_text(encoding="utf-8")
    assert f"error is over {100 * UNSURE:.0f} % of the person's size" in page


def test_a_joint_of_a_large_error_hides_nothing() -> None:
    size_m, bone = 2.0, coloured(0.01)
    assert coloured(0.9 * UNSURE * size_m) > 2 * bone
    for error_m in (1.1 * UNSURE * size_m, 50.0, np.inf):
        assert 0 < coloured(error_m) < 1.5 * bone
