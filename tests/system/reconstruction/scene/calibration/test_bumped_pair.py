"""A camera that was turned about its axis, in the middle of a take, is not taken for its neighbour."""

from dataclasses import replace

import cv2
import numpy as np

from benchmarks.reconstruction.body_takes import room_of, views_of
from reconstruction.scene.calibration.consistency import check_rig, find_mixups
from reconstruction.scene.pairs import detect_features

TURN_PX = 12.0


def test_a_bumped_camera_is_not_exchanged() -> None:
    """With each other's calibrations the points fitted within 3 px, as the wrong poses hide a turn."""
    views, room, rng = views_of(1), room_of("people", 1), np.random.default_rng(0)
    turn = cv2.Rodrigues(np.array([0.0, 0.0, TURN_PX / 350]))[0]
    right = views["right"]
    bumped = replace(right, rotation=turn @ right.rotation, translation=turn @ right.translation)
    seen = views | {"right": bumped}
    features = {name: detect_features(room.look(view, 0.1, rng)) for name, view in seen.items()}
    assert find_mixups(views, features) == []
    assert "left or right moved" in str(check_rig(views, features))
