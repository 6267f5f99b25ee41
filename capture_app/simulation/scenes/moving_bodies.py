"""What moves: a child of rigid parts that jumps or walks, and a pinwheel that turns; meshes, textures, poses.

All motion is a smooth periodic function of time, for ever.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from capture_app.simulation.scenes import materials
from capture_app.simulation.scenes.materials import Colour, Picture
from capture_app.simulation.scenes.meshes import Mesh, box, ellipsoid, lathe, rod, sheet, turn

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
"""One hop of the jumping child."""
CONTACT_S = 0.12
TAKE_OFF_M_S = 9.81 * (HOP_S - CONTACT_S) / 2
"""2.6 m/s: what gravity turns round within the flight."""
SWAY_M = 0.13
TURN_S = 3.9
FIGURE_AT = (-0.30, 2.44)
"""x and z in m of the middle of the sway."""
LEG_M = 0.505
"""Hip to ankle when the feet leave the floor: knees a little bent."""

LAP_S = 6.5
"""One round of the walking child; a whole part of CYCLE_NS."""
GAIT_S = 0.65
WALK_CENTRE = (0.0, 2.75)
"""x and z in m of the middle of the path."""
WALK_REACH_M = (1.55, 0.42)
"""Half axes of the path along x and z: 1.5 m/s where they pass each other, in the middle."""


class Poses(NamedTuple):
    """Poses at n times: x_world = rotation (n, 3, 3) x_part + translation (n, 3) in m."""

    rotation: Series
    translation: Series

    def point(self, x: float, y: float, z: float) -> Series:
        """World positions (n, 3) of a point of the part, in m."""
        return np.asarray(self.rotation @ np.array([x, y, z]) + self.translation)


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


def hop_height(time_s: Series) -> Series:
    """Height in m of the hips over their place at take-off: a flight, then a springy landing."""
    phase = time_s % HOP_S
    flight = phase - CONTACT_S
    landing = -TAKE_OFF_M_S * phase * (1 - phase / CONTACT_S)
    return np.where(flight < 0, landing, TAKE_OFF_M_S * flight - 9.81 / 2 * flight**2)


def jumping_child(time_s: Series) -> dict[str, Poses]:
    """Poses of the jumping child's parts at the times (n), by the part's name.

    Where the hop stands still, at its top and at its lowest point, the sideways sway runs at 0.7 of its
    full speed: two pictures some tens of ms apart always show the child in two places.
    """
    height = hop_height(time_s)
    airborne = np.sin(np.pi * np.clip((time_s % HOP_S - CONTACT_S) / (HOP_S - CONTACT_S), 0, 1)) ** 2
    # Still only midway between the lowest point and the top, where the hop is fast.
    sway = np.pi * (time_s - CONTACT_S / 2) / HOP_S + np.pi / 4
    yaw = 0.42 * np.sin(2 * np.pi * time_s / TURN_S)
    roll = 0.09 * np.cos(sway)

    leg = LEG_M + np.minimum(height, 0.0) - 0.085 * airborne
    x, z = FIGURE_AT[0] + SWAY_M * np.sin(sway), FIGURE_AT[1] + 0.05 * np.cos(sway)
    y = FLOOR_Y - ANKLE_M - LEG_M - height
    hips = Poses(turn(1, yaw) @ turn(2, roll), np.stack([x, y, z], axis=1))
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


def walking_child(time_s: Series, *, ahead: float, prefix: str) -> dict[str, Poses]:
    """Poses by the part's name of a child that is `ahead` laps further on; names begin with `prefix`."""
    round_ = 2 * np.pi * (time_s / LAP_S + ahead)
    gait = 2 * np.pi * (time_s / GAIT_S + 2 * ahead)
    speed = np.stack([-WALK_REACH_M[0] * np.sin(round_), WALK_REACH_M[1] * np.cos(round_)])
    yaw = np.arctan2(-speed[0], -speed[1])

    swing = {side: 0.52 * np.sin(gait + (np.pi if side > 0 else 0.0)) for side in (-1.0, 1.0)}
    knee = {side: 0.16 + 0.38 * (1 + np.cos(gait + (np.pi if side > 0 else 0.0))) for side in (-1.0, 1.0)}
    leg = np.maximum(*(_height(swing[side], knee[side]) for side in (-1.0, 1.0)))
    x = WALK_CENTRE[0] + WALK_REACH_M[0] * np.cos(round_)
    z = WALK_CENTRE[1] + WALK_REACH_M[1] * np.sin(round_)
    place = np.stack([x, FLOOR_Y - ANKLE_M - HIP_Y - leg, z], axis=1)
    hips = Poses(turn(1, yaw) @ turn(2, 0.04 * np.sin(gait)), place)

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


SKIN: Colour = (224, 168, 132)
HAIR: Colour = (106, 66, 40)


@dataclass(frozen=True)
class Part:
    """Meshes of one rigid part, about its joint if it moves, and the thing it belongs to."""

    thing: str
    meshes: list[Mesh]


def pictures(rng: np.random.Generator) -> dict[str, Picture]:
    """Textures of the moving_bodies, by name."""
    stripes: list[Colour] = [(188, 52, 50), (240, 230, 208), (44, 60, 100), (240, 230, 208)]
    found = {
        "face": materials.face(rng, SKIN, HAIR),
        "hair": materials.hair(rng, (160, 320), HAIR),
        "shirt": materials.cloth(rng, (220, 330), stripes, stripe=17),
        "sleeve": materials.cloth(rng, (64, 96), stripes, stripe=14),
        "jeans": materials.denim(rng, (160, 200)),
        "skin": materials.plain(rng, (160, 160), SKIN, rough=0.05),
        "shoe": materials.cloth(rng, (96, 160), [(196, 54, 50)]),
        "sole": materials.plain(rng, (32, 96), (238, 234, 224)),
        "ribbon": materials.cloth(rng, (32, 32), [(62, 140, 178)]),
        "hub": materials.plain(rng, (48, 48), (238, 190, 70)),
    }
    for number in range(6):
        found[f"blade{number}"] = materials.blade(rng, number)
    return found


def parts() -> dict[str, Part]:
    """All moving parts, by the names that `poses` gives their poses."""
    child = {"hips": _hips(), "torso": _torso(), "head": _head()}
    for side in ("left", "right"):
        thigh = [
            (0.001, -0.055), (0.05, -0.045), (0.073, 0.0), (0.070, 0.08), (0.060, 0.18),
            (0.054, 0.26), (0.03, 0.29),
        ]  # fmt: skip
        child[f"{side}_thigh"] = [lathe(thigh, "jeans", depth=1.05)]
        child[f"{side}_shin"] = [
            lathe(
                [(0.03, -0.04), (0.052, -0.02), (0.054, 0.05), (0.052, 0.14), (0.049, 0.215), (0.050, 0.235)],
                "jeans",
            ),
            lathe([(0.036, 0.20), (0.034, 0.27)], "skin"),
        ]
        child[f"{side}_shoe"] = [
            ellipsoid((0.043, 0.042, 0.098), "shoe").moved((0.0, 0.016, -0.035)),
            lathe([(0.040, 0.0), (0.045, 0.006), (0.045, 0.022), (0.04, 0.026)], "sole", depth=2.25).moved(
                (0.0, 0.036, -0.035)
            ),
            lathe([(0.041, -0.035), (0.044, 0.0), (0.046, 0.03)], "shoe", depth=1.1),
        ]
        child[f"{side}_arm"] = [
            ellipsoid((0.050, 0.052, 0.050), "sleeve"),
            lathe([(0.050, 0.0), (0.050, 0.05), (0.053, 0.115), (0.050, 0.12)], "sleeve"),
            lathe([(0.034, 0.08), (0.033, 0.14), (0.031, 0.19), (0.02, 0.215)], "skin"),
        ]
        child[f"{side}_forearm"] = [
            lathe([(0.02, -0.022), (0.031, 0.0), (0.032, 0.04), (0.027, 0.12), (0.023, 0.165)], "skin"),
            ellipsoid((0.031, 0.046, 0.022), "skin").moved((0.0, 0.196, 0.0)),
            ellipsoid((0.011, 0.028, 0.012), "skin").moved((0.0, 0.186, -0.026), turn(0, -0.5)),
        ]
    found = {name: Part("figure", meshes) for name, meshes in child.items()}
    found["wheel"] = Part("pinwheel", _wheel())
    return found


def _hips() -> list[Mesh]:
    outline = [(0.098, -0.075), (0.106, -0.03), (0.112, 0.02), (0.104, 0.065), (0.06, 0.10), (0.001, 0.105)]
    return [lathe(outline, "jeans", depth=0.74)]


def _torso() -> list[Mesh]:
    outline = [
        (0.030, -0.405), (0.052, -0.395), (0.088, -0.382), (0.118, -0.360), (0.129, -0.325), (0.126, -0.26),
        (0.118, -0.18), (0.114, -0.10), (0.118, -0.03), (0.122, 0.012), (0.119, 0.016),
    ]  # fmt: skip
    neck = lathe([(0.040, -0.47), (0.040, -0.42), (0.050, -0.392)], "skin")
    return [lathe(outline, "shirt", depth=0.70, around=40), neck]


def _head() -> list[Mesh]:
    centre, radii = (0.0, -0.155, 0.0), np.array([0.100, 0.126, 0.108])
    skull = ellipsoid(radii, "face", around=48).moved(centre)
    meshes = [skull, _hair(radii * 1.075).moved(centre)]
    for side in (-1, 1):
        meshes.append(ellipsoid((0.016, 0.026, 0.018), "skin", around=14).moved((side * 0.098, -0.15, 0.004)))
        bunch = ellipsoid((0.040, 0.075, 0.044), "hair", around=20)
        meshes.append(bunch.moved((side * 0.142, -0.165, 0.03), turn(2, -side * 0.45)))
        meshes.append(
            ellipsoid((0.020, 0.020, 0.024), "ribbon", around=12).moved((side * 0.110, -0.215, 0.02))
        )
    meshes.append(ellipsoid((0.013, 0.012, 0.014), "skin", around=14).moved((0.0, -0.133, -0.107)))
    return meshes


def _hair(radii: np.ndarray) -> Mesh:
    """A cap over crown and neck: a sheet whose lower edge is high at the face, in strands."""
    around = 97
    angle = np.linspace(0, 2 * np.pi, around)
    front = np.exp(-(((angle - np.pi) / 0.95) ** 4))
    fringe = 0.10 * np.abs(np.sin(angle * 5.0 + 0.6)) * front + 0.03 * np.sin(angle * 23)
    lowest = 2.35 - 1.42 * front + fringe
    polar = np.linspace(0.02, 1.0, 14)[:, None] * lowest
    swell = 1.0 - 0.06 * (np.linspace(0, 1, 14)[:, None] > 0.95)
    rx, ry, rz = radii
    x, z = -rx * swell * np.sin(polar) * np.sin(angle), rz * swell * np.sin(polar) * np.cos(angle)
    return sheet(np.stack([x, -ry * swell * np.cos(polar), z], axis=-1), "hair", closed=True)


def _wheel() -> list[Mesh]:
    meshes = []
    inner, outer = 0.02, 0.285
    for number in range(6):
        u, v = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9))
        radius = inner + (outer - inner) * v
        width = np.deg2rad(55) * (1.0 - 0.22 * v**3)
        angle = width * (u - 0.5)
        # Paper that is folded forward along its leading edge, as a pinwheel's blades are.
        curl = -0.055 * u**2 * np.sin(np.pi * np.clip(v * 1.05, 0, 1)) + 0.018 * (1 - u) * v
        points = np.stack([radius * np.sin(angle), -radius * np.cos(angle), curl], axis=-1)
        meshes.append(
            sheet(points, f"blade{number}", window=(0, 1, 1, 0)).moved((0, 0, 0), turn(2, number * np.pi / 3))
        )
    meshes.append(ellipsoid((0.030, 0.030, 0.022), "hub", around=20).moved((0.0, 0.0, -0.03)))
    return meshes


def stand() -> list[Mesh]:
    """The pinwheel's pole and foot, which stand still."""
    x, y, z = WHEEL_HUB
    pole = rod((x, y, z + 0.055), (x, FLOOR_Y - 0.02, z + 0.055), 0.013, "pale_wood")
    axle = rod((x, y, z - 0.01), (x, y, z + 0.06), 0.006, "dark_wood")
    foot = lathe([(0.02, -0.035), (0.10, -0.022), (0.125, -0.012), (0.13, 0.0)], "dark_wood").moved(
        (x, FLOOR_Y, z + 0.055)
    )
    return [pole, axle, foot, *box((x, FLOOR_Y - 0.03, z + 0.055), (0.05, 0.05, 0.05), "pale_wood")]
