"""Scenes of several drawn people, with detections that err as real detectors do. Simulated.

People walk apart, cross, embrace, stand behind a table, leave and come back; a mirror or a poster shows
somebody who is not there;
somebody is seen by two cameras only; adults and children are together. Detections have noise in proportion to
a person's size (some of it constant for seconds), exchange left and right, miss people and joints, hide what
is behind somebody or give it the joints of whom is in front, find halves of people, find people twice, and
see people where nobody is.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.people.figure import JOINTS, Floats, Motion, moving, pixels_of, ring
from reconstruction.common.geometry import View
from reconstruction.methods.people.joint_positions import Person
from reconstruction.methods.people.keypoints import FrameJoints
from reconstruction.methods.people.people_run import CameraFrames, PeopleFinder
from reconstruction.methods.people.skeletons import SKELETONS

SECONDS, FRAMES_PER_S = 4.0, 30
KINDS = ("apart", "crossing", "embrace", "leaving", "mirror", "poster", "two cameras", "two scales")
MIRROR_FOR_ALL = "mirror for all"
"""A kind beside the others: all cameras see one person's reflection, who cannot be told from a person."""
NOISE, BIAS = 0.008, 0.008
"""Standard deviations of a joint's pixel relative to the person's size: of each frame, and constant."""
BODY_M = 0.09
"""Half the width of what a limb hides."""
MISSES, SWAPS, PARTS, TWICE, CLUTTER = 0.02, 0.015, 0.03, 0.02, 0.03
"""Rates at which a spell of misses, of exchanged sides, of halves found apart, of somebody found
twice, or of somebody who is not there begins, a frame."""
SPELL = 0.2
"""Rate at which it ends."""
STOLEN = 0.5
"""Fraction of hidden joints for which those of whom is in front are taken."""
LEGS = JOINTS.index("left_hip")
"""The first joint of the lower half."""
BONES = np.array(SKELETONS["blazepose"].bones)
MIRRORED = np.array(
    [
        JOINTS.index(
            name.replace("left", "~").replace("right", "left").replace("~", "right")
            if "left" in name or "right" in name
            else name
        )
        for name in JOINTS
    ]
)


class SceneOfPeople(NamedTuple):
    """What cameras see, and the truth at the first camera's frames.

    `truth` is (people, times, joints, 3), m, NaN = absent; `visible` (people, times, joints) says
    which joints two cameras show. Somebody who comes back after more than a second is somebody else.
    """

    frames: dict[str, CameraFrames]
    times_s: Floats
    truth: Floats
    visible: NDArray[np.bool_]


def walker(begin: Floats, end: Floats, rng: np.random.Generator, height: float = 1.0) -> Motion:
    """Return somebody who walks on a straight line from a place to another, m, in SECONDS."""
    way = end - begin
    base = moving("walk", phase=float(rng.uniform(0, 6.28)))
    heading = float(np.arctan2(way[1], way[0]))
    cosine, sine = np.cos(heading), np.sin(heading)
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])

    def at(times: Floats) -> Floats:
        joints = base(times)
        joints[..., 0] -= joints[:, 23:25, 0].mean(axis=1)[:, None]
        along = np.column_stack([begin + way * (times / SECONDS)[:, None], 0 * times])
        return np.asarray(height * (joints @ turn) + along[:, None])

    return at


def people_of(kind: str, number: int, rng: np.random.Generator) -> list[Motion]:
    """Return the motions of a scene's people."""
    angle = rng.uniform(0, 6.28)

    def place(radius: float, turn: float) -> Floats:
        return radius * np.array([np.cos(angle + turn), np.sin(angle + turn)])

    spots = [place(1.3, 2 * np.pi * k / number) for k in range(number)]
    people = [walker(spot, spot * rng.uniform(0.6, 0.9), rng) for spot in spots]
    aside = place(rng.uniform(0.22, 0.35), np.pi / 2)
    if kind == "crossing":
        people[:2] = [
            walker(place(1.6, 0) + aside, place(-1.6, 0) + aside, rng),
            walker(place(-1.6, 0) - aside, place(1.6, 0) - aside, rng),
        ]
    if kind == "embrace":
        # Aside from where the others stand: nobody begins within somebody.
        pair = [walker(place(sign * 1.3, np.pi / 6), place(sign * -0.9, np.pi / 6), rng) for sign in (1, -1)]
        people[:2] = [_halted(one, 0.46 * SECONDS) for one in pair]
    if kind == "two scales":
        people = [
            walker(spot, spot * rng.uniform(0.6, 0.9), rng, 0.55 if k % 2 else 1.0)
            for k, spot in enumerate(spots)
        ]
    return people


def _halted(motion: Motion, halt_s: float) -> Motion:
    """Return somebody who walks on to a time, stays for a second, and walks back."""
    return lambda times: motion(np.minimum(times, np.clip(2 * halt_s + 1 - times, 0, halt_s)))


def draw(
    kind: str, cameras: int, number: int, seed: int, *, late: float = 0.0, seconds: float = SECONDS
) -> SceneOfPeople:
    """Draw the beginning of a scene; every second camera's frames are `late` (frames) after the others'."""
    rng = np.random.default_rng([(*KINDS, MIRROR_FOR_ALL).index(kind), cameras, number, seed])
    motions = people_of(kind, number, rng)
    views = ring(cameras, 180 if cameras < 5 else 300)
    times = np.arange(0, seconds, 1 / FRAMES_PER_S)
    stays = [_stays(kind, k, rng) for k in range(number)]
    blind = rng.permutation(cameras)[2:].tolist() if kind == "two cameras" else []
    heights = np.array([np.ptp(motion(times[:1])[0, :, 2]) for motion in motions])
    bodies = rng.normal(0, BIAS, (number, len(JOINTS), 3)) * heights[:, None, None]
    frames, shown = dict[str, CameraFrames](), np.zeros((number, len(times), len(JOINTS)), int)
    for camera, view in enumerate(views):
        own_s = times + late * (camera % 2) / FRAMES_PER_S
        joints = [motion(own_s) for motion in motions]
        odd = _who_is_not_there(kind, camera, joints[0], view, rng)
        seen = _Detections(view, joints, bodies, rng)
        found = dict[int, FrameJoints]()
        for k, at_s in enumerate(own_s):
            there = [
                one for one in range(number)
                if stays[one](float(at_s)) and not (one == number - 1 and camera in blind)
            ]  # fmt: skip
            detected = seen.of_frame(k, there)
            for one in there:
                shown[one, k] += np.any([joints for who, _, _, joints in detected if who == one], axis=0)
            everybody = [*((pixels, sure) for _, pixels, sure, _ in detected), *odd(k)]
            order = rng.permutation(len(everybody))
            found[k] = FrameJoints(
                np.array([everybody[place][0] for place in order]).reshape(-1, len(JOINTS), 2),
                np.array([everybody[place][1] for place in order]).reshape(-1, len(JOINTS)),
            )
        frames[f"cam{camera}"] = CameraFrames(view, own_s, 0.0, 0.0, found)
    truth, visible = list[Floats](), list[NDArray[np.bool_]]()
    for one, motion in enumerate(motions):
        stays_now = np.array([stays[one](float(at_s)) for at_s in times])
        stints = np.cumsum(np.diff(stays_now, prepend=False) & stays_now) * stays_now
        for stint in range(1, stints.max() + 1):
            truth.append(np.where((stints == stint)[:, None, None], motion(times), np.nan))
            visible.append((shown[one] >= 2) & (stints == stint)[:, None])
    return SceneOfPeople(frames, times, np.array(truth), np.array(visible))


def draw_take(kind: str, cameras: int, seed: int, *, late: float = 0.0) -> SceneOfPeople:
    """Draw a take of a bench: of two to four people by its seed, or five at two scales."""
    return draw(kind, cameras, 5 if kind == "two scales" else 2 + seed % 3, seed, late=late)


def locate_people(scene: SceneOfPeople) -> Sequence[Person]:
    """Return the people that simulshot locates at a scene's times, of whose detector it knows the bias."""
    bias = np.full(len(JOINTS), BIAS)
    finder = PeopleFinder(scene.frames, SKELETONS["blazepose"], 1 / FRAMES_PER_S, bias=bias)
    return finder.at(scene.times_s).people


def _stays(kind: str, number: int, rng: np.random.Generator) -> Callable[[float], bool]:
    """Return whether somebody is there at a time: some leave and come back."""
    if kind != "leaving" or number > 1:
        return lambda at_s: True
    leaves, away = rng.uniform(1.0, 1.5), 0.5 if number else 1.5
    if away < 1.0:
        return lambda at_s: at_s > leaves
    return lambda at_s: not leaves < at_s < leaves + away


def _who_is_not_there(
    kind: str, camera: int, joints: Floats, view: View, rng: np.random.Generator
) -> Callable[[int], list[tuple[Floats, Floats]]]:
    """Return who is detected in a camera without being there: mirrored, on a poster, or by mistake."""
    sure = np.full(len(JOINTS), 0.8)
    poster = pixels_of(view, joints[:1] * 0.9 + [0.6, 0.5, 0.3])[0]
    mirror = pixels_of(view, joints @ np.diag([1.0, -1.0, 1.0]) + [0, 3.5, 0])[:, MIRRORED]
    mistake = dict[str, Floats]()

    def odd(frame: int) -> list[tuple[Floats, Floats]]:
        if rng.random() < (SPELL if mistake else CLUTTER):
            if mistake:
                mistake.clear()
            else:
                shape = poster - poster.mean(axis=0)
                middle = rng.uniform([0, 0], [view.width, view.height])
                mistake["pixels"] = shape * rng.uniform(0.3, 1.0) + middle
        noise = rng.normal(0, 4.0, (len(JOINTS), 2))
        somebody = [one + noise for one in mistake.values()]
        if kind == "poster" and camera == 0:
            somebody.append(poster + noise)
        if kind == MIRROR_FOR_ALL or (kind == "mirror" and camera == 1):
            somebody.append(mirror[frame] + noise)
        return [(pixels, sure) for pixels in somebody]

    return odd


class _Detections:
    """What a detector finds of people in one camera's frames, with spells of misses and exchanged sides."""

    def __init__(self, view: View, joints: list[Floats], bodies: Floats, rng: np.random.Generator) -> None:
        self.view, self.joints, self.rng = view, joints, rng
        self.pixels = [pixels_of(view, one + body) for one, body in zip(joints, bodies, strict=True)]
        self.depths = [(one @ view.rotation.T + view.translation)[..., 2].mean(axis=1) for one in joints]
        sizes = [np.linalg.norm(np.ptp(one, axis=1), axis=1).mean() for one in self.pixels]
        self.own = [rng.normal(0, BIAS * size, (len(JOINTS), 2)) for size in sizes]
        self.spells = np.zeros((4, len(joints)), bool)
        # A table hides legs in some cameras.
        self.table = view.height * (rng.uniform(0.5, 0.65) if rng.random() < 0.3 else 2.0)

    def of_frame(self, k: int, there: list[int]) -> list[tuple[int, Floats, Floats, NDArray[np.bool_]]]:
        """Return (person, pixels, confidences, whether each joint is seen) of all detections of people."""
        begins = np.array([[MISSES], [SWAPS], [PARTS], [TWICE]])
        self.spells ^= self.rng.random(self.spells.shape) < np.where(self.spells, SPELL, begins)
        found = list[tuple[int, Floats, Floats, NDArray[np.bool_]]]()
        for one in there:
            missed, swapped, parts, twice = self.spells[:, one]
            pixels = self.pixels[one][k]
            size = float(np.linalg.norm(np.ptp(pixels, axis=0)))
            hidden = pixels[:, 1] > self.table
            noisy = pixels + self.own[one] + self.rng.normal(0, NOISE * size, pixels.shape)
            guessed = np.zeros(len(JOINTS), bool)
            for other in there:
                if self.depths[other][k] < self.depths[one][k] - 0.1:
                    behind = self._behind(pixels, other, k)
                    hidden |= behind
                    stolen = behind & (self.rng.random(len(JOINTS)) < STOLEN)
                    noisy[stolen], guessed[stolen] = self.pixels[other][k][stolen], True
            seen = ~hidden & (self.rng.random(len(JOINTS)) > 0.03)
            seen &= ((pixels >= 0) & (pixels < [self.view.width, self.view.height])).all(axis=1)
            if (seen | guessed).mean() < 0.25 or missed:
                continue
            sure = self.rng.uniform(0.5, 1.0, len(JOINTS))
            confidence = np.where(seen, sure, np.where(guessed, 0.6 * sure, 0.0))
            if swapped:
                noisy, confidence = noisy[MIRRORED], confidence[MIRRORED]
            upper = np.arange(len(JOINTS)) < LEGS
            for part in (upper, ~upper) if parts else (upper | True,):
                found.append((one, noisy, np.where(part, confidence, 0.0), seen & part))
            if twice:
                again = np.where(self.rng.random(len(JOINTS)) < 0.5, confidence * 0.8, 0.0)
                found.append((one, noisy + self.rng.normal(0, 2 * NOISE * size, pixels.shape), again, seen))
        return found

    def _behind(self, pixels: Floats, other: int, k: int) -> NDArray[np.bool_]:
        """Return which pixels (joints, 2) are behind somebody's limbs or trunk."""
        begin, end = self.pixels[other][k][BONES].transpose(1, 0, 2)
        along = end - begin
        part = ((pixels[:, None] - begin) * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-9)
        away = np.linalg.norm(pixels[:, None] - begin - part.clip(0, 1)[..., None] * along, axis=2)
        return np.asarray((away < BODY_M * self.view.focal / self.depths[other][k]).any(axis=1))
