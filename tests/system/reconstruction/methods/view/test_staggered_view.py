"""A staggered rig whose cameras share steps: each step is a moment with depth, and a picture of one film."""

import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from reconstruction import open_session
from reconstruction.method.picture_quality import psnr
from tests.unit.reconstruction.conftest import PERIOD_NS, Scene, make_view
from tests.unit.reconstruction.methods.view.test_staggered_view import pairs  # noqa: F401 - a fixture


def test_one_film_has_a_picture_of_each_step_at_twice_the_rate(scene: Scene, pairs: Session) -> None:
    middle = make_view((0.0, 0.0, 0.0))
    session = open_session(pairs.folder)
    made = session.view(path=(middle.to_calibration(),) * 4, instants=(), quick=True)
    assert (made.result.instants, made.result.steps) == ((0, 1, 2, 3), 2)
    true = [np.repeat(scene.look(middle, k / 2)[0][..., None], 3, axis=2) for k in range(4)]
    _, _, moving = scene.look(middle, 0.5)
    fits = [[psnr(made.frame(k), one, moving) for one in true] for k in range(4)]
    assert np.argmax(fits, axis=1).tolist() == [0, 1, 2, 3]
    still = session.view(path="still", instants=(), quick=True).result
    assert (still.frames, still.fps) == (4, pytest.approx(2e9 / PERIOD_NS, rel=1e-3))
