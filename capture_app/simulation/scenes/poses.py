"""Poses of rigid parts over time, and the sizes of the child and the pinwheel.

All motion is a smooth periodic function of time, for ever.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Series = NDArray[np.float64]

CYCLE_NS = 97_500_000_000
"""All motion repeats after this time: whole numbers of hops, sways, turns of the body and the wheel."""

WHEEL_TURNS_PER_S = 1.2
WHEEL_HUB = (0.40, 0.14, 2.24)
FLOOR_Y = 1.0

THIGH_M = SHIN_M = 0.26
ANKLE_M = 0.065
HIP_HALF_M = 0.064
HIP_Y = 0.045
SHOULDER = (0.132, -0.335)
UPPER_ARM_M = 0.19
NECK_Y = -0.395


class Poses(NamedTuple):
    """Poses at n times: x_world = rotation (n, 3, 3) x_part + translation (n, 3) in m."""

    rotation: Series
    translation: Series

    def point(self, x: float, y: float, z: float) -> Series:
        """World positions (n, 3) of a point of the part, in m."""
        return np.asarray(self.rotation @ np.array([x, y, z]) + self.translation)


def turn(axis: int, angle: Series) -> Series:
    """Rotation matrices (n, 3, 3) by the angles (n), in radians, about axis 0, 1 or 2."""
    out = np.zeros((len(angle), 3, 3))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out[:, axis, axis] = 1.0
    out[:, a, a] = out[:, b, b] = np.cos(angle)
    out[:, b, a] = np.sin(angle)
    out[:, a, b] = -out[:, b, a]
    return out


def joint(parent: Poses, at: tuple[float, float, float], rotation: Series) -> Poses:
    """Poses of a part whose origin is at a point of its parent, rotated against it by (n, 3, 3)."""
    return Poses(parent.rotation @ rotation, parent.point(*at))


class LimbTurns(NamedTuple):
    """Rotations (n, 3, 3) of one side's limbs against their parents; the shoe's is against the world."""

    thigh: Series
    shin: Series
    shoe: Series
    arm: Series
    forearm: Series


def child_poses(
    hips: Poses, torso_turn: Series, head_turn: Series, left: LimbTurns, right: LimbTurns
) -> dict[str, Poses]:
    """Poses of all parts of a child by name, from the pose of its hips and the rotations of its joints."""
    torso = joint(hips, (0.0, 0.02, 0.0), torso_turn)
    parts = {"hips": hips, "torso": torso, "head": joint(torso, (0.0, NECK_Y, -0.005), head_turn)}
    for side, name, turns in ((-1.0, "left", left), (1.0, "right", right)):
        thigh = joint(hips, (side * HIP_HALF_M, HIP_Y, 0.0), turns.thigh)
        shin = joint(thigh, (0.0, THIGH_M, 0.0), turns.shin)
        arm = joint(torso, (side * SHOULDER[0], SHOULDER[1], 0.0), turns.arm)
        parts[f"{name}_thigh"] = thigh
        parts[f"{name}_shin"] = shin
        parts[f"{name}_shoe"] = Poses(turns.shoe, shin.point(0.0, SHIN_M, 0.0))
        parts[f"{name}_arm"] = arm
        parts[f"{name}_forearm"] = joint(arm, (0.0, UPPER_ARM_M, 0.0), turns.forearm)
    return parts


def cycle_seconds(times_ns: NDArray[np.int64]) -> Series:
    """Seconds within the cycle, exact to a ns wherever in 64 bits the times lie."""
    return (times_ns % CYCLE_NS).astype(np.float64) / 1e9


def turning_wheel(time_s: Series) -> dict[str, Poses]:
    """Poses of the pinwheel's blades, which face the cameras with a slight slant."""
    slant = turn(1, np.full_like(time_s, 0.16)) @ turn(0, np.full_like(time_s, 0.07))
    turning = turn(2, 2 * np.pi * WHEEL_TURNS_PER_S * time_s)
    return {"wheel": Poses(slant @ turning, np.broadcast_to(np.array(WHEEL_HUB), (len(time_s), 3)))}
