"""`reconstruct view`: films and pictures of a session from places without a camera."""

import numpy as np

from capture_app.session.reading.reader import Session
from reconstruction import open_session
from reconstruction.common.geometry import View
from reconstruction.method.picture_quality import psnr, ssim
from tests.project import JUMPER
from tests.unit.reconstruction.methods.view.test_view import pictures  # noqa: F401 - a fixture


def test_a_session_is_shown_from_a_camera_of_its_own(boards: Session) -> None:
    session = open_session(boards.folder)
    lens = session.calibration().cameras["left"]
    made = session.view(path=(lens,), quick=True)
    assert made.result.frames == 1
    own = session.frame("left", 0).bgr()
    assert psnr(made.frame(0), own) > 28
    assert np.array_equal(made.render(lens), made.frame(0))


def test_a_held_out_view_of_jumper() -> None:
    """Simulated pictures, a sixth camera 8 cm from the nearest: 26.5 dB and 0.950 when it was written."""
    from benchmarks.reconstruction.novel_view_scenes import true_views

    held = true_views("jumper", ["between"])["between"]
    made = open_session(JUMPER).view(instant=3, path=(held.view.to_calibration(),)).frame(0)
    assert psnr(made, held.picture) > 26
    assert ssim(made, held.picture) > 0.945
    assert isinstance(held.view, View)
