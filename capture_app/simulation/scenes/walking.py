"""How two children walk round and round: poses as smooth periodic functions of time, for ever."""

import numpy as np

from capture_app.simulation.scenes.poses import (
    ANKLE_M,
    FLOOR_Y,
    HIP_HALF_M,
    NECK_Y,
    SHIN_M,
    SHOULDER,
    THIGH_M,
    UPPER_ARM_M,
    Poses,
    Series,
    joint,
    turn,
)

LAP_S = 6.5
"""A whole part of CYCLE_NS."""
GAIT_S = 0.65
CENTRE = (0.0, 2.75)
"""x and z in m of the middle of the path."""
REACH_M = (1.55, 0.42)
"""Half axes of the path along x and z: 1.5 m/s where they pass each other, in the middle."""
_HIP_Y = 0.045


def walking_child(time_s: Series, *, ahead: float, prefix: str) -> dict[str, Poses]:
    """Poses by the part's name of a child that is `ahead` laps further on; names begin with `prefix`."""
    round_ = 2 * np.pi * (time_s / LAP_S + ahead)
    gait = 2 * np.pi * (time_s / GAIT_S + 2 * ahead)
    speed = np.stack([-REACH_M[0] * np.sin(round_), REACH_M[1] * np.cos(round_)])
    yaw = np.arctan2(-speed[0], -speed[1])

    swing = {side: 0.52 * np.sin(gait + (np.pi if side > 0 else 0.0)) for side in (-1.0, 1.0)}
    knee = {side: 0.16 + 0.38 * (1 + np.cos(gait + (np.pi if side > 0 else 0.0))) for side in (-1.0, 1.0)}
    leg = np.maximum(*(_height(swing[side], knee[side]) for side in (-1.0, 1.0)))
    hips = Poses(
        turn(1, yaw) @ turn(2, 0.04 * np.sin(gait)),
        np.stack(
            [
                CENTRE[0] + REACH_M[0] * np.cos(round_),
                FLOOR_Y - ANKLE_M - _HIP_Y - leg,
                CENTRE[1] + REACH_M[1] * np.sin(round_),
            ],
            axis=1,
        ),
    )
    torso = joint(hips, (0.0, 0.02, 0.0), turn(1, -0.10 * np.sin(gait)) @ turn(0, np.full_like(yaw, 0.09)))
    parts = {
        "hips": hips,
        "torso": torso,
        "head": joint(torso, (0.0, NECK_Y, -0.005), turn(0, 0.03 * np.cos(2 * gait) - 0.05)),
    }
    for side, name in ((-1.0, "left"), (1.0, "right")):
        thigh = joint(hips, (side * HIP_HALF_M, _HIP_Y, 0.0), turn(0, -swing[side]))
        shin = joint(thigh, (0.0, THIGH_M, 0.0), turn(0, knee[side]))
        parts[f"{name}_thigh"] = thigh
        parts[f"{name}_shin"] = shin
        pitch = turn(0, 0.6 * (knee[side] - swing[side]) - 0.12)
        parts[f"{name}_shoe"] = Poses(hips.rotation @ pitch, shin.point(0.0, SHIN_M, 0.0))
        upper = joint(
            torso,
            (side * SHOULDER[0], SHOULDER[1], 0.0),
            turn(2, np.full_like(yaw, -side * 0.16)) @ turn(0, 0.75 * swing[side]),
        )
        parts[f"{name}_arm"] = upper
        parts[f"{name}_forearm"] = joint(upper, (0.0, UPPER_ARM_M, 0.0), turn(0, -0.45 - 0.3 * swing[side]))
    return {prefix + name: poses for name, poses in parts.items()}


def _height(swing: Series, knee: Series) -> Series:
    """From hip to ankle, downwards in m."""
    return np.asarray(THIGH_M * np.cos(swing) + SHIN_M * np.cos(knee - swing))
