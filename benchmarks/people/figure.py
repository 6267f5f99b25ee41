"""A figure that walks, runs and throws: the true joints of BlazePose's skeleton at any time. Simulated."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from reconstruction.common.geometry import View, look_along
from reconstruction.methods.people.keypoints import FrameJoints
from reconstruction.methods.people.people_run import CameraFrames
from reconstruction.methods.people.skeletons import SKELETONS

Floats = NDArray[np.float64]
JOINTS = SKELETONS["blazepose"].joints
Motion = Callable[[Floats], Floats]
"""Joints (n, 33, 3), m with z up, at times (n,), s."""
FOCAL_PX, SIZE, RADIUS_M, HEIGHT_M = 1000.0, (1920, 1080), 4.0, 1.3


def _limb(begin: Floats, lengths: Sequence[float], angles: Sequence[Floats], aside: Floats) -> list[Floats]:
    """Return the ends of a chain of bones that turn in the plane of x and z, by angles from straight down."""
    ends, at = list[Floats](), begin
    for length, angle in zip(lengths, angles, strict=True):
        at = at + length * np.stack([np.sin(angle), aside, -np.cos(angle)], axis=1)
        ends.append(at)
    return ends


def moving(
    kind: str, place: tuple[float, float] = (0.0, 0.0), heading: float = 0.0, phase: float = 0.0
) -> Motion:
    """Return a motion: walk (hands to 2 m/s), run (to 5) or throw (to 10), from a place, m, at a heading."""
    rate, stride, swing, bend = {"walk": (1.0, 0.45, 0.4, 0.5), "run": (1.5, 0.7, 0.9, 1.2)}.get(
        kind, (0.6, 0.25, 0.3, 0.3)
    )
    speed = {"walk": 0.6, "run": 1.0}.get(kind, 0.1)

    def at(times: Floats) -> Floats:
        cycle = 2 * np.pi * rate * times + phase
        zero = np.zeros_like(times)
        hip = np.stack([speed * np.sin(times + phase), zero, 0.95 + 0.03 * np.cos(2 * cycle)], axis=1)
        found = dict[str, Floats]()
        chest = hip + np.stack([0.05 * np.sin(cycle), zero, zero + 0.5], axis=1)
        for side, sign in (("left", 1.0), ("right", -1.0)):
            legs = stride * np.sin(cycle) * sign
            found[f"{side}_hip"] = hip + np.array([0, 0.12 * sign, 0])
            knee, ankle = _limb(
                found[f"{side}_hip"],
                (0.43, 0.42),
                (legs, legs - bend * np.maximum(0, np.cos(cycle) * sign) ** 2),
                zero,
            )
            found |= {
                f"{side}_knee": knee,
                f"{side}_ankle": ankle,
                f"{side}_heel": ankle + np.array([-0.05, 0, -0.06]),
            }
            found[f"{side}_foot_index"] = ankle + np.array([0.17, 0, -0.06])
            arm = -swing * np.sin(cycle) * sign
            if kind == "throw" and side == "right":
                # The upper arm and the forearm turn by 2.6 rad within a fifth of a second, once in 1.5 s.
                turn = 1 / (1 + np.exp(-(np.mod(times + phase, 1.5) - 0.75) / 0.045))
                back = 1 / (1 + np.exp(-(np.mod(times + phase, 1.5) - 1.3) / 0.05))
                arm = 3.3 * turn - 2.5 - 0.4 * back
            found[f"{side}_shoulder"] = chest + np.array([0, 0.2 * sign, 0])
            elbow, wrist = _limb(
                found[f"{side}_shoulder"],
                (0.3, 0.27),
                (arm, arm + 0.4 + 0.3 * np.sin(cycle)),
                zero + 0.05 * sign,
            )
            hand = wrist - elbow
            found |= {f"{side}_elbow": elbow, f"{side}_wrist": wrist}
            for name, along, aside in (("pinky", 0.3, -0.03), ("index", 0.35, 0.0), ("thumb", 0.2, 0.04)):
                found[f"{side}_{name}"] = wrist + along * hand + np.array([0, aside * sign, 0])
            for name, across in (("eye_inner", 0.02), ("eye", 0.035), ("eye_outer", 0.05), ("ear", 0.08)):
                forward = 0.0 if name == "ear" else 0.1
                found[f"{side}_{name}"] = chest + np.array([forward, across * sign, 0.25])
            found[f"mouth_{side}"] = chest + np.array([0.1, 0.03 * sign, 0.17])
        found["nose"] = chest + np.array([0.13, 0, 0.22])
        joints = np.stack([found[name] for name in JOINTS], axis=1)
        cosine, sine = np.cos(heading), np.sin(heading)
        turned = joints @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
        return np.asarray(turned + np.array([*place, 0.0]))

    return at


def ring(number: int, degrees: float = 180.0) -> list[View]:
    """Return cameras on an arc around the figure, 4 m away, 1920x1080."""
    views = list[View]()
    for k in range(number):
        angle = np.radians(degrees) * k / max(number - 1, 1) + 0.3
        centre = np.array([RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), HEIGHT_M + 0.4 * (k % 2)])
        ahead = np.array([0.0, 0.0, 0.9]) - centre
        rotation = look_along(ahead / np.linalg.norm(ahead), np.array([0.0, 0.0, -1.0]))
        width, height = SIZE
        matrix = np.array([[FOCAL_PX, 0, width / 2 - 0.5], [0, FOCAL_PX, height / 2 - 0.5], [0, 0, 1.0]])
        views.append(View(width, height, matrix, np.zeros(5), rotation, -rotation @ centre))
    return views


def pixels_of(view: View, points: Floats) -> Floats:
    """Return the pixels (..., 2) of points (..., 3)."""
    camera = points @ view.rotation.T + view.translation
    projected = camera @ view.matrix.T
    return np.asarray(projected[..., :2] / projected[..., 2:])


def seen_by(
    view: View,
    motions: Sequence[Motion],
    frame_s: Floats,
    rng: np.random.Generator,
    *,
    noise_px: float = 3.0,
    time_error_s: float = 0.0,
    late_s: float = 0.0,
) -> CameraFrames:
    """Return what a camera sees of figures, in random order in each frame, at times (n,) that it reports.

    Its frames are in truth `late_s` later, and each camera's clock is off by one draw of `time_error_s`.
    """
    truth_s = frame_s + late_s + rng.normal(0, time_error_s or 0.0)
    frames = dict[int, FrameJoints]()
    at = [pixels_of(view, motion(truth_s)) for motion in motions]
    for k in range(len(frame_s)):
        order = rng.permutation(len(motions))
        pixels = np.stack([at[one][k] for one in order])
        pixels = pixels + rng.normal(0, noise_px, pixels.shape)
        frames[k] = FrameJoints(pixels, np.ones(pixels.shape[:2]))
    return CameraFrames(view, frame_s, 0.0, time_error_s, frames)
