"""A staggered rig whose cameras share steps: each step is a moment with depth, and a picture of one film."""

from pathlib import Path

import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from reconstruction import open_session
from reconstruction.scene.dataset import Dataset
from reconstruction.scores.picture_quality import psnr
from tests.reconstruction.conftest import PERIOD_NS, Scene, make_view, write_session

CAMERAS = {
    "a": make_view((-0.15, 0.0, 0.0), yaw=2.0),
    "b": make_view((0.05, 0.01, 0.0), yaw=-0.7),
    "c": make_view((-0.05, 0.01, 0.0), yaw=0.7),
    "d": make_view((0.15, 0.0, 0.0), yaw=-2.0),
}
PAIRS = {"c": 0.5, "d": 0.5}


@pytest.fixture(scope="module")
def pairs(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Two instants of a rig whose second pair is half a period later."""
    root = tmp_path_factory.mktemp("staggered")
    return write_session(root, scene, CAMERAS, instants=2, steps=PAIRS)


def test_steps_count_where_cameras_share_them(scene: Scene, pairs: Session, tmp_path: Path) -> None:
    assert Dataset(pairs).steps_ns == {"a": 0, "b": 0, "c": PERIOD_NS // 2, "d": PERIOD_NS // 2}
    even = {name: place / 4 for place, name in enumerate(CAMERAS)}
    alone = write_session(tmp_path, scene, CAMERAS, instants=1, steps=even)
    assert {*Dataset(alone).steps_ns.values()} == {0}


@pytest.mark.slow
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
