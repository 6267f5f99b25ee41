"""How two children walk round and round: poses as smooth periodic functions of time, for ever."""

import numpy as np

from capture_app.simulation.scenes.poses import (
    ANKLE_M,
    FLOOR_Y,
    HIP_Y,
    SHIN_M,
    THIGH_M,
    LimbTurns,
    Poses,
    Series,
    child_poses,
    turn,
)

LAP_S = 6.5
"""A whole part of CYCLE_NS."""
GAIT_S = 0.65
CENTRE = (0.0, 2.75)
"""x and z in m of the middle of the path."""
REACH_M = (1.55, 0.42)
"""Half axes of the path along x and z: 1.5 m/s where they pass each other, in the middle."""


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
                FLOOR_Y - ANKLE_M - HIP_Y - leg,
                CENTRE[1] + REACH_M[1] * np.sin(round_),
            ],
            axis=1,
        ),
    )

    def limbs(side: float) -> LimbTurns:
        pitch = turn(0, 0.6 * (knee[side] - swing[side]) - 0.12)
        return LimbTurns(
            thigh=turn(0, -swing[side]),
            shin=turn(0, knee[side]),
            shoe=hips.rotation @ pitch,
            arm=turn(2, np.full_like(yaw, -side * 0.16)) @ turn(0, 0.75 * swing[side]),
            forearm=turn(0, -0.45 - 0.3 * swing[side]),
        )

    torso = turn(1, -0.10 * np.sin(gait)) @ turn(0, np.full_like(yaw, 0.09))
    head = turn(0, 0.03 * np.cos(2 * gait) - 0.05)
    parts = child_poses(hips, torso, head, limbs(-1.0), limbs(1.0))
    return {prefix + name: poses for name, poses in parts.items()}


def _height(swing: Series, knee: Series) -> Series:
    """From hip to ankle, downwards in m."""
    return np.asarray(THIGH_M * np.cos(swing) + SHIN_M * np.cos(knee - swing))
