"""The three cameras of most tests of depth from all cameras."""

import pytest

from capture_app.session.reading.reader import Session
from tests.unit.reconstruction.conftest import Scene, make_view, write_session

VIEWS = {
    "left": make_view((-0.14, 0.0, 0.0), yaw=1.5),
    "middle": make_view((0.0, 0.03, 0.0), distortion=(-0.05, 0.01, 0.0, 0.0, 0.0)),
    "right": make_view((0.14, 0.0, 0.0), yaw=-1.5),
}


@pytest.fixture(scope="module")
def trio(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Three cameras that see the boards, one of them with distortion; five instants."""
    return write_session(tmp_path_factory.mktemp("trio"), scene, VIEWS)
