"""Errors of cameras' poses against the true ones, whatever the world's place, rotation and scale."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from reconstruction.common.geometry import Array, angle_deg

Pose = tuple[Array, Array]
"""Rotation 3x3 and translation (3,), camera from world."""


def relative_pose_errors(found: Mapping[str, Pose], true: Mapping[str, Pose]) -> list[tuple[float, float]]:
    """Errors of each two cameras that were found: of their rotation against each other, and of the
    direction from one to the other; degrees. The world's place, turn and scale do not matter."""
    errors = []
    for a, b in combinations(sorted(found), 2):
        (turn, way), (true_turn, true_way) = (_relative(poses[a], poses[b]) for poses in (found, true))
        cosine = (np.trace(turn @ true_turn.T) - 1) / 2
        errors.append((float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))), angle_deg(way, true_way)))
    return errors


def _relative(a: Pose, b: Pose) -> Pose:
    """Rotation from a's frame to b's, and where b stands in a's frame."""
    turn = b[0] @ a[0].T
    return turn, a[1] - turn.T @ b[1]
