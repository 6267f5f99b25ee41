"""Motion of rigid parts: a child that jumps or walks, and a pinwheel that turns.

All motion is a smooth periodic function of time.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

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

HOP_S = 0.65
"""Duration of one hop of the jumping child."""
CONTACT_S = 0.12
TAKE_OFF_M_S = 9.81 * (HOP_S - CONTACT_S) / 2
"""2.6 m/s: the speed that gravity reverses within the flight."""
SWAY_M = 0.13
YAW_PERIOD_S = 3.9
FIGURE_AT = (-0.30, 2.44)
"""x and z in m of the middle of the sway."""
LEG_M = 0.505
"""Distance from hip to ankle when the feet leave the floor, with slightly bent knees."""

LAP_S = 6.5
"""Duration of one round of the walking child; it divides CYCLE_NS."""
GAIT_S = 0.65
WALK_CENTRE = (0.0, 2.75)
"""x and z in m of the middle of the path."""
WALK_AXES_M = (1.55, 0.42)
"""Half axes of the path along x and z: 1.5 m/s where the children pass each other, in the middle."""


class Poses(NamedTuple):
    """Poses at n times: x_world = rotation (n, 3, 3) x_part + translation (n, 3) in m."""

    rotation: Series
    translation: Series

    def point(self, x: float, y: float, z: float) -> Series:
        """Return the world positions (n, 3) of a point of the part, in m."""
        return np.asarray(self.rotation @ np.array([x, y, z]) + self.translation)


def rotation(axis: int, angle: ArrayLike) -> NDArray[np.float64]:
    """Return rotation matrices (..., 3, 3) by angles (...), in radians, about x, y or z (0, 1, 2).

    A positive angle rotates y to z, z to x, or x to y.
    """
    out = np.zeros((*np.shape(angle), 3, 3))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out[..., axis, axis] = 1.0
    out[..., a, a] = out[..., b, b] = np.cos(angle)
    out[..., b, a] = np.sin(angle)
    out[..., a, b] = -out[..., b, a]
    return out


def joint(parent: Poses, at: tuple[float, float, float], rotation: Series) -> Poses:
    """Return poses of a part whose origin is a point of its parent, rotated against it by (n, 3, 3)."""
    return Poses(parent.rotation @ rotation, parent.point(*at))


LimbTurns = dict[str, Series]
"""Rotations (n, 3, 3) of one side's limbs against their parents; the shoe's is against the world."""


def child_poses(
    hips: Poses, torso_angle: Series, head_angle: Series, left: LimbTurns, right: LimbTurns
) -> dict[str, Poses]:
    """Return poses of a child's parts by name, from the pose of its hips and its joints' rotations."""
    torso = joint(hips, (0.0, 0.02, 0.0), torso_angle)
    parts = {"hips": hips, "torso": torso, "head": joint(torso, (0.0, NECK_Y, -0.005), head_angle)}
    for side, name, turns in ((-1.0, "left", left), (1.0, "right", right)):
        thigh = joint(hips, (side * HIP_HALF_M, HIP_Y, 0.0), turns["thigh"])
        shin = joint(thigh, (0.0, THIGH_M, 0.0), turns["shin"])
        arm = joint(torso, (side * SHOULDER[0], SHOULDER[1], 0.0), turns["arm"])
        parts |= {
            f"{name}_thigh": thigh,
            f"{name}_shin": shin,
            f"{name}_shoe": Poses(turns["shoe"], shin.point(0.0, SHIN_M, 0.0)),
            f"{name}_arm": arm,
            f"{name}_forearm": joint(arm, (0.0, UPPER_ARM_M, 0.0), turns["forearm"]),
        }
    return parts


def cycle_seconds(times_ns: NDArray[np.int64]) -> Series:
    """Return seconds within the cycle, exact to 1 ns for any 64-bit times."""
    return (times_ns % CYCLE_NS).astype(np.float64) / 1e9


def turning_wheel(time_s: Series) -> dict[str, Poses]:
    """Return poses of the pinwheel's blades, which face the cameras with a slight slant."""
    slant = rotation(1, np.full_like(time_s, 0.16)) @ rotation(0, np.full_like(time_s, 0.07))
    turning = rotation(2, 2 * np.pi * WHEEL_TURNS_PER_S * time_s)
    return {"wheel": Poses(slant @ turning, np.broadcast_to(np.array(WHEEL_HUB), (len(time_s), 3)))}


def hop_height(time_s: Series) -> Series:
    """Return the hips' height in m above their position at take-off: a flight, then a springy landing."""
    phase = time_s % HOP_S
    flight = phase - CONTACT_S
    landing = -TAKE_OFF_M_S * phase * (1 - phase / CONTACT_S)
    return np.where(flight < 0, landing, TAKE_OFF_M_S * flight - 9.81 / 2 * flight**2)


def jumping_child(time_s: Series) -> dict[str, Poses]:
    """Return poses of the jumping child's parts at n times, by the part's name.

    At the top and the lowest point, where the hop has no speed, the sideways sway runs at 0.7 of its full
    speed. Two images some tens of ms apart therefore always show the child in two places.
    """
    height = hop_height(time_s)
    airborne = np.sin(np.pi * np.clip((time_s % HOP_S - CONTACT_S) / (HOP_S - CONTACT_S), 0, 1)) ** 2
    # The sway stops only midway between the lowest point and the top, where the hop is fast.
    sway = np.pi * (time_s - CONTACT_S / 2) / HOP_S + np.pi / 4
    yaw = 0.42 * np.sin(2 * np.pi * time_s / YAW_PERIOD_S)
    roll = 0.09 * np.cos(sway)

    leg = LEG_M + np.minimum(height, 0.0) - 0.085 * airborne
    x, z = FIGURE_AT[0] + SWAY_M * np.sin(sway), FIGURE_AT[1] + 0.05 * np.cos(sway)
    y = FLOOR_Y - ANKLE_M - LEG_M - height
    hips = Poses(rotation(1, yaw) @ rotation(2, roll), np.stack([x, y, z], axis=1))
    lean = 0.10 + 0.10 * np.cos(2 * np.pi * (time_s - CONTACT_S / 2) / HOP_S)
    knee = np.arccos(np.clip(leg / (THIGH_M + SHIN_M), -1, 1))

    def limbs(side: float) -> LimbTurns:
        leg_angle = side * (0.06 + 0.42 * airborne)
        level = rotation(1, np.full_like(yaw, -side * 0.22)) @ rotation(0, 0.55 * airborne)
        beat = np.cos(2 * np.pi * (time_s - CONTACT_S / 2 + side * 0.02) / HOP_S)
        raised = 1.28 - 0.72 * beat + side * 0.16 * np.sin(2 * np.pi * time_s / YAW_PERIOD_S)
        bent = 0.55 - 0.30 * beat
        return {
            "thigh": rotation(2, -leg_angle) @ rotation(0, -knee),
            "shin": rotation(0, 2 * knee),
            "shoe": hips.rotation @ level,
            "arm": rotation(2, -side * raised) @ rotation(0, np.full_like(beat, -0.25)),
            "forearm": rotation(2, -side * bent) @ rotation(0, -0.3 * bent),
        }

    head = rotation(1, -0.45 * yaw) @ rotation(0, -0.9 * lean + 0.05)
    return child_poses(hips, rotation(0, lean), head, limbs(-1.0), limbs(1.0))


def walking_child(time_s: Series, *, ahead: float, prefix: str) -> dict[str, Poses]:
    """Return poses by part name of a child that is `ahead` laps further on; names begin with `prefix`."""
    round_ = 2 * np.pi * (time_s / LAP_S + ahead)
    gait = 2 * np.pi * (time_s / GAIT_S + 2 * ahead)
    speed = np.stack([-WALK_AXES_M[0] * np.sin(round_), WALK_AXES_M[1] * np.cos(round_)])
    yaw = np.arctan2(-speed[0], -speed[1])

    swing = {side: 0.52 * np.sin(gait + (np.pi if side > 0 else 0.0)) for side in (-1.0, 1.0)}
    knee = {side: 0.16 + 0.38 * (1 + np.cos(gait + (np.pi if side > 0 else 0.0))) for side in (-1.0, 1.0)}
    leg = np.maximum(*(_height(swing[side], knee[side]) for side in (-1.0, 1.0)))
    x = WALK_CENTRE[0] + WALK_AXES_M[0] * np.cos(round_)
    z = WALK_CENTRE[1] + WALK_AXES_M[1] * np.sin(round_)
    place = np.stack([x, FLOOR_Y - ANKLE_M - HIP_Y - leg, z], axis=1)
    hips = Poses(rotation(1, yaw) @ rotation(2, 0.04 * np.sin(gait)), place)

    def limbs(side: float) -> LimbTurns:
        pitch = rotation(0, 0.6 * (knee[side] - swing[side]) - 0.12)
        return {
            "thigh": rotation(0, -swing[side]),
            "shin": rotation(0, knee[side]),
            "shoe": hips.rotation @ pitch,
            "arm": rotation(2, np.full_like(yaw, -side * 0.16)) @ rotation(0, 0.75 * swing[side]),
            "forearm": rotation(0, -0.45 - 0.3 * swing[side]),
        }

    torso = rotation(1, -0.10 * np.sin(gait)) @ rotation(0, np.full_like(yaw, 0.09))
    head = rotation(0, 0.03 * np.cos(2 * gait) - 0.05)
    return {
        prefix + name: poses
        for name, poses in child_poses(hips, torso, head, limbs(-1.0), limbs(1.0)).items()
    }


def _height(swing: Series, knee: Series) -> Series:
    """Return the distance from hip to ankle, downwards in m."""
    return np.asarray(THIGH_M * np.cos(swing) + SHIN_M * np.cos(knee - swing))
