"""How a child jumps on the spot: poses of its parts at any time.

Where the hop stands still, at its top and at its lowest point, the sideways sway runs at 0.7 of its
full speed: two pictures some tens of ms apart always show the child in two places.
"""

import numpy as np

from capture_app.simulation.scenes.poses import (
    ANKLE_M,
    FLOOR_Y,
    SHIN_M,
    THIGH_M,
    LimbTurns,
    Poses,
    Series,
    child_poses,
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
    knee = np.arccos(np.clip(leg / (THIGH_M + SHIN_M), -1, 1))

    def limbs(side: float) -> LimbTurns:
        spread = side * (0.06 + 0.42 * airborne)
        level = turn(1, np.full_like(yaw, -side * 0.22)) @ turn(0, 0.55 * airborne)
        beat = np.cos(2 * np.pi * (time_s - CONTACT_S / 2 + side * 0.02) / HOP_S)
        raised = 1.28 - 0.72 * beat + side * 0.16 * np.sin(2 * np.pi * time_s / TURN_S)
        bent = 0.55 - 0.30 * beat
        return LimbTurns(
            thigh=turn(2, -spread) @ turn(0, -knee),
            shin=turn(0, 2 * knee),
            shoe=hips.rotation @ level,
            arm=turn(2, -side * raised) @ turn(0, np.full_like(beat, -0.25)),
            forearm=turn(2, -side * bent) @ turn(0, -0.3 * bent),
        )

    head = turn(1, -0.45 * yaw) @ turn(0, -0.9 * lean + 0.05)
    return child_poses(hips, turn(0, lean), head, limbs(-1.0), limbs(1.0))
