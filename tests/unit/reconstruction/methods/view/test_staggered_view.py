"""A staggered rig whose cameras share steps: each step is a moment with depth, and a picture of one film."""

from pathlib import Path

import pytest

from capture_app.session.reading.reader import Session
from reconstruction.scene.dataset import Dataset
from tests.unit.reconstruction.conftest import PERIOD_NS, Scene, make_view, write_session

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
