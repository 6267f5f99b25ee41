"""What moves in small pictures is seen; noise, light and what has become usual are not."""

import numpy as np

from capture_app.rig.motion_watch import MotionWatch
from tests.unit.rig.test_motion import Scene


def test_an_hour_with_nothing_moving_moves_nothing() -> None:
    scene, watch = Scene(), MotionWatch()
    for second in range(3600):
        # The sun comes and goes, and a cloud dims all at once.
        light = 0.9 + 0.1 * np.sin(second / 300) - 0.08 * (second % 600 < 60)
        assert not watch.moved("a", scene.picture(light=light)), second
