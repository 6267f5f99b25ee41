"""How a child jumps on the spot: poses of its parts at any time.

Where the hop stands still, at its top and at its lowest point, the sideways sway runs at 0.7 of its
full speed: two pictures some tens of ms apart always show the child in two places.
"""

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

HOP_S = 0.65
CONTACT_S = 0.12
TAKE_OFF_M_S = 9.81 * (HOP_S - CONTACT_S) / 2
"""2.6 m/s: what gravity turns round within the flight."""
SWAY_M = 0.13
TURN_S = 3.9
FIGURE_AT = (-0.30, 2.44)
"""x and z in m of the middle of the sway."""
LEG_M = 0.505
"""Hip to ankle when the feet leave the floor: knees a little bent."""


def hop_height(time_s: Series) -> Series:
    """Height in m of the hips over their place at take-off: a flight, then a springy landing."""
    phase = time_s % HOP_S
    flight = phase - CONTACT_S
    landing = -TAKE_OFF_M_S * phase * (1 - phase / CONTACT_S)
    return np.where(flight < 0, landing, TAKE_OFF_M_S * flight - 9.81 / 2 * flight**2)


def jumping_child(time_s: Series) -> dict[str, Poses]:
    """Poses of the jumping child's parts at the times (n), by the part's name."""
    height = hop_height(time_s)
    airborne = np.sin(np.pi * np.clip((time_s % HOP_S - CONTACT_S) / (HOP_S - CONTACT_S), 0, 1)) ** 2
    # Still only midway between the lowest point and the top, where the hop is fast.
    sway = np.pi * (time_s - CONTACT_S / 2) / HOP_S + np.pi / 4
    yaw = 0.42 * np.sin(2 * np.pi * time_s / TURN_S)
    roll = 0.09 * np.cos(sway)

    leg = LEG_M + np.minimum(height, 0.0) - 0.085 * airborne
    hips = Poses(
        turn(1, yaw) @ turn(2, roll),
        np.stack(
            [
                FIGURE_AT[0] + SWAY_M * np.sin(sway),
                FLOOR_Y - ANKLE_M - LEG_M - height,
                FIGURE_AT[1] + 0.05 * np.cos(sway),
            ],
            axis=1,
        ),
    )
    lean = 0.10 + 0.10 * np.cos(2 * np.pi * (time_s - CONTACT_S / 2) / HOP_S)
    torso = joint(hips, (0.0, 0.02, 0.0), turn(0, lean))
    parts = {
        "hips": hips,
        "torso": torso,
        "head": joint(torso, (0.0, NECK_Y, -0.005), turn(1, -0.45 * yaw) @ turn(0, -0.9 * lean + 0.05)),
    }
    for side, name in ((-1.0, "left"), (1.0, "right")):
        spread = side * (0.06 + 0.42 * airborne)
        knee = np.arccos(np.clip(leg / (THIGH_M + SHIN_M), -1, 1))
        thigh = joint(hips, (side * HIP_HALF_M, 0.045, 0.0), turn(2, -spread) @ turn(0, -knee))
        shin = joint(thigh, (0.0, THIGH_M, 0.0), turn(0, 2 * knee))
        level = turn(1, np.full_like(yaw, -side * 0.22)) @ turn(0, 0.55 * airborne)
        parts[f"{name}_thigh"] = thigh
        parts[f"{name}_shin"] = shin
        parts[f"{name}_shoe"] = Poses(hips.rotation @ level, shin.point(0.0, SHIN_M, 0.0))

        beat = np.cos(2 * np.pi * (time_s - CONTACT_S / 2 + side * 0.02) / HOP_S)
        raised = 1.28 - 0.72 * beat + side * 0.16 * np.sin(2 * np.pi * time_s / TURN_S)
        bent = 0.55 - 0.30 * beat
        upper = joint(
            torso,
            (side * SHOULDER[0], SHOULDER[1], 0.0),
            turn(2, -side * raised) @ turn(0, np.full_like(beat, -0.25)),
        )
        parts[f"{name}_arm"] = upper
        parts[f"{name}_forearm"] = joint(
            upper, (0.0, UPPER_ARM_M, 0.0), turn(2, -side * bent) @ turn(0, -0.3 * bent)
        )
    return parts
