"""Who is who: detections of all cameras become individuals in space, at each time, those before first.

Each step takes the frames of one time. Individuals seen before are projected into each camera, and the
detections there are assigned to them by the distance of joints; what is left becomes new individuals where
rays agree. After 4D association (Zhang et al. 2020) and mvpose (Dong et al. 2019), without parts and looks.
"""

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from typing import NamedTuple

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.methods.people.assignment import assign
from reconstruction.methods.people.joint_positions import locate, to_pixels
from reconstruction.methods.people.joint_tracks import Track, size_of

GATE = 0.1
"""Largest mean distance of an individual's joints from a detection's, relative to its size in the image."""
CAP = 0.15
"""Distance beyond which one joint counts no more: limbs that somebody in front has stolen decide nothing. By
three and four cameras 45 of 48 drawn takes are right with it and 2.3 % of the joints missing, 41 and 3.4 %
with twice as much (simulated, 2026-11)."""
NAMED = 0.03
"""What a name that an individual had before is worth, as a distance."""
AGREE = 0.04
"""Largest median distance of one individual's pixels from its joints, relative to its size."""
UNSEEN = 0.25
"""What a camera that should show an individual and does not is worth, beside 1 for one that shows it well."""
ONE_BODY = 0.1
"""Median distance of joints below which two individuals are one, relative to their size."""
MIN_OWN = 0.5
"""Least fraction of an individual's steps at which detections of its own show it: two, or one where at most
one camera does not. Those of people half behind others, or one and a poster, agree by chance."""
SHADE, MUCH_NEARER = 0.07, 3
"""A detection at most so far from an older individual is not a younger one's own, unless that one is so many
times nearer."""
MIN_NEAR = 0.5
"""Least fraction of an individual's known joints that cameras locate where it should be. Where fewer are,
detections of somebody else are taken for it: by three cameras 38 of 40 drawn takes are right with it, 36 with
0.3 (simulated, 2026-11)."""
MIN_SHARED = 4
"""Fewest joints by which an individual and a detection are compared."""
MIRRORED = 0.03
"""Distance by which left and right must fit better if they are exchanged."""
MIN_STEPS, MIN_DENSITY = 6, 0.25
"""Fewest steps at which two cameras show an individual, or half of all, and their least fraction from its
first to its last: what flickers is nobody."""
MIN_KNOWN = 0.1
"""Least fraction of an individual's joints that are located from its first step to its last. With 0.25, and
with twice the density, three of 56 drawn takes by three cameras lack somebody who is half hidden (simulated,
2026-11)."""
MAX_LOST_S = 1.0
"""Time after which an individual that nothing was seen of ends."""
MAX_BLIND_S = 0.25
"""Time after which one camera alone finds nobody again: it may see a mistake, or somebody else."""
JUMP, DRIFT, STRIDE = 0.06, 0.3, 0.6
"""Largest distance from where an individual should be at which its own detections, or new ones, locate it,
relative to its size, and its growth a second. Cameras that face each other do not see how far away somebody
between them is: by three cameras in a half circle 44 of 48 drawn takes are right with a jump of 0.06 at most,
40 without a limit, and 1.4 instead of 8.4 in 1,000 persons are too many (simulated, 2026-11)."""
MAX_BOTH = 0.5
"""Largest part of a path's times at which another one of the same individual is seen."""
NOISE = 0.012
"""Standard deviation of a pixel, relative to an individual's size, by which rays agree."""
STEP = 0.75
"""Longest time between frames that are matched with each other, in periods."""


class Detections(NamedTuple):
    """Detections in one frame: pixels (n, joints, 2) without distortion, confidences (n, joints), 0 = unseen.

    `times_s` (n, joints) are of each joint's row; `names` are empty if the source follows nobody.
    """

    times_s: Array
    pixels: Array
    confidence: Array
    names: tuple[str, ...]


Path = list[tuple[float, Array, float]]
"""Times at which two cameras show an individual, s, its joints (joints, 3) then, and how many are located."""
Places = dict[tuple[int, int], list[int]]
"""An individual's detections by camera and frame: the best first, then those of its other parts."""


@dataclass(eq=False)
class Individual:
    """An individual, and where its joints were last: positions (joints, 3), NaN = unknown for a second."""

    joints: Array
    known_s: Array
    seen_s: float
    size: float
    speed: Array
    places: Places = field(default_factory=dict)
    names: dict[int, str] = field(default_factory=dict)
    confirmed: list[int] = field(default_factory=list)
    """Steps at which at least two cameras show it."""
    own: int = 1
    """Number of steps at which detections of its own show it: see `MIN_OWN`."""

    def is_somebody(self, steps: int, known: float = np.inf) -> bool:
        """Whether it is more than an agreement by chance, in so many steps without a long pause.

        `known` is the sum over steps of the fraction of its joints that were located.
        """
        number = len(self.confirmed)
        span = self.confirmed[-1] - self.confirmed[0] + 1 if number else 0
        return self.own >= MIN_OWN * number >= MIN_OWN * max(
            1, min(MIN_STEPS, steps / 2), MIN_DENSITY * span
        ) and known >= max(min(MIN_STEPS, steps / 4), MIN_KNOWN * span)

    def at(self, time_s: float) -> Array:
        """Return where its joints should be at a time, (joints, 3)."""
        return np.asarray(self.joints + self.speed * (time_s - self.seen_s))


class PersonMatcher:
    """Finds the individuals of a session, step by step in time."""

    def __init__(
        self,
        projections: Array,
        sizes: Array,
        detections: Sequence[Mapping[int, Detections]],
        joints: Sequence[str],
    ) -> None:
        self.projections, self.sizes, self.detections = projections, sizes, detections
        self.mirror = mirrored(joints)
        self.ended, self.active, self.step = list[Individual](), list[Individual](), -1

    def match(self, frame_s: Sequence[Array], period_s: float) -> list[Individual]:
        """Return the individuals, by the times (frames,) of each camera's frames, NaN = no frame."""
        steps, paths = _steps(frame_s, period_s), dict[Individual, Path]()
        for frames in steps:
            times = {camera: float(frame_s[camera][k]) for camera, k in frames.items()}
            self.follow(frames, times)
            for one in self.active:
                if one.confirmed[-1:] == [self.step]:
                    known = float((one.known_s == one.seen_s).mean())
                    paths.setdefault(one, []).append((one.seen_s, one.joints.copy(), known))
        begins_s = np.array([min(frame_s[camera][k] for camera, k in frames.items()) for frames in steps])
        take = np.cumsum(np.diff(begins_s, prepend=begins_s[:1]) > MAX_LOST_S)
        long = np.bincount(take)
        people = list[Individual]()
        for individual, path in _joined(paths).items():
            number = int(long[take[individual.confirmed[0]]])
            # Mistakes of two cameras among many agree for a while.
            min_places = min(MIN_STEPS, number / 4) * len(self.projections) / 2
            known = sum(known for *_, known in path)
            if individual.is_somebody(number, known) and len(individual.places) >= min_places:
                people.append(individual)
        return people

    def tracks(self, individual: Individual, frames: Sequence[int]) -> list[Track]:
        """Return one track a camera of an individual, by the numbers of the cameras' frames."""
        tracks = list[Track]()
        for number, count in enumerate(frames):
            shape = count, len(self.mirror)
            track = Track(number, np.full(shape, np.nan), np.full((*shape, 2), np.nan), np.zeros(shape))
            for (camera, k), places in individual.places.items():
                if camera == number:
                    whole = merged(self.detections[camera][k], places)
                    track.pixels[k], track.confidence[k], track.times_s[k] = whole
            tracks.append(track)
        return tracks

    def follow(self, frames: Mapping[int, int], times: Mapping[int, float]) -> None:
        """Take the next step in time, by each camera's frame and its time."""
        self.step += 1
        with warnings.catch_warnings():
            # Means of what is unknown everywhere.
            warnings.simplefilter("ignore", RuntimeWarning)
            self._step(frames, times)

    def _step(self, frames: Mapping[int, int], times: Mapping[int, float]) -> None:
        now_s = float(np.mean(list(times.values())))
        self.ended += [one for one in self.active if now_s - one.seen_s > MAX_LOST_S]
        self.active = [one for one in self.active if now_s - one.seen_s <= MAX_LOST_S]
        here = {camera: self.detections[camera].get(k) for camera, k in frames.items()}
        seen = {camera: one for camera, one in here.items() if one is not None and len(one.pixels)}
        taken = {camera: self._predicted(camera, one, times[camera]) for camera, one in seen.items()}
        free = {camera: {*range(len(one.pixels))} for camera, one in seen.items()}
        sure = self._go_on(seen, taken, frames, times, now_s)
        for individual in (self.active[n] for n in sure):
            for camera, left in free.items():
                left -= {*individual.places.get((camera, frames[camera]), [])}
        apart = {
            camera: {n: self._nearest(camera, self.active[n], one, times[camera]) for n in sure}
            for camera, one in seen.items()
        }
        self._end_ghosts(sure, apart, frames)
        # Who is found a second time, or in part, begins nobody.
        for camera, left in free.items():
            taken_here = {place for owned in taken[camera].values() for place in owned}
            for number in sure:
                left -= {*np.flatnonzero(apart[camera][number] < GATE).tolist()} - taken_here
        weak = {number: one for number, one in enumerate(self.active) if number not in sure}
        self._begin(seen, free, frames, [*weak.values()], [self.active[n] for n in sure], now_s)
        for number, individual in weak.items():
            for camera, owners in taken.items():
                if now_s - MAX_BLIND_S <= individual.seen_s < now_s and free[camera].issuperset(
                    owners.get(number, [-1])
                ):
                    self._follow(individual, camera, seen[camera], owners[number][0], now_s)
                    individual.places[camera, frames[camera]] = owners[number]

    def _go_on(
        self,
        seen: Mapping[int, Detections],
        taken: Mapping[int, Mapping[int, list[int]]],
        frames: Mapping[int, int],
        times: Mapping[int, float],
        now_s: float,
    ) -> list[int]:
        """Move individuals to the detections that each has; return the numbers of these, the oldest first."""
        sure, bodies = list[int](), list[tuple[Array, float]]()
        points = self._located(seen, taken, times, now_s)
        for number in sorted(range(len(points)), key=lambda n: -len(self.active[n].confirmed)):
            individual = self.active[number]
            places = {camera: owned[number] for camera, owned in taken.items() if number in owned}
            if self._on_a_body(points[number], individual.size, bodies):
                # Others are hidden there, and go on later.
                if len(individual.confirmed) < MIN_STEPS:
                    individual.seen_s = -np.inf
            elif len(places) > 1 and self._accept(individual, points[number], places, frames, seen, now_s):
                sure.append(number)
                bodies.append((individual.joints, individual.size))
        return sure

    def _predicted(self, camera: int, seen: Detections, time_s: float) -> dict[int, list[int]]:
        """Return the detections of each active individual in a camera's frame, by number."""
        if not self.active:
            return {}
        predicted = np.array([one.at(time_s) for one in self.active])
        # Detectors exchange left and right of whole bodies.
        costs = np.array([
            [
                self._distances(camera, joints[order], one.size, seen)
                for joints, one in zip(predicted, self.active, strict=True)
            ]
            for order in (slice(None), self.mirror)
        ])  # fmt: skip
        exchanged = costs[1] + MIRRORED < costs[0]
        costs = np.where(exchanged, costs[1], costs[0])
        for row, one in enumerate(self.active):
            for place, name in enumerate(seen.names):
                costs[row, place] -= NAMED * (one.names.get(camera) == name)
        taken = {row: [place] for row, place in assign(costs, GATE)}
        # A body that is found in parts, or twice.
        for place in {*range(len(seen.pixels))} - {first for first, *_ in taken.values()}:
            row = int(costs[:, place].argmin())
            if row in taken and costs[row, place] < GATE / 2:
                taken[row].append(place)
        for row, own in taken.items():
            for place in own:
                if exchanged[row, place]:
                    for part in seen[:3]:
                        part[place] = part[place][self.mirror]
        return taken

    def _distances(self, camera: int, joints: Array, size: float, seen: Detections) -> Array:
        """Return the mean distances (n,) of joints (joints, 3) from detections, relative to their size."""
        at, depth = to_pixels(self.projections[camera], joints)
        known = (seen.confidence > 0) & np.isfinite(at[:, 0]) & (depth > 0)
        scale = size * self.sizes[camera] / np.maximum(np.nanmean(depth), 1e-9)
        distances = np.linalg.norm(np.nan_to_num(at) - np.nan_to_num(seen.pixels), axis=2) / scale
        return _mean_distances(distances, known)

    def _located(
        self,
        seen: Mapping[int, Detections],
        taken: Mapping[int, Mapping[int, list[int]]],
        times: Mapping[int, float],
        now_s: float,
    ) -> list[Array]:
        """Return the joints (joints, 3) of the active individuals by the detections that each has."""
        number = len(self.active)
        if not number:
            return []
        joints = len(self.active[0].joints)
        pixels = np.full((len(self.projections), number, joints, 2), np.nan)
        for camera, owners in taken.items():
            for row, owned in owners.items():
                one = self.active[row]
                pixels[camera, row] = merged(seen[camera], owned)[0]
                # A frame of another time is moved by the whole body's speed.
                there, then = (
                    to_pixels(self.projections[camera], one.at(at_s))[0] for at_s in (now_s, times[camera])
                )
                pixels[camera, row] += np.nan_to_num(there - then)
        sizes = np.array([one.size for one in self.active])
        expected = np.array([one.at(now_s) for one in self.active])
        # Where cameras disagree, those are believed that show an individual where it should be.
        near, alone = self._points(pixels, sizes, expected, (expected.reshape(-1, 3), None))
        points = np.where(np.isfinite(near), near, alone)
        number_near, number_known = (np.isfinite(part[..., 0]).sum(axis=1) for part in (near, points))
        limits = [(JUMP + STRIDE * (now_s - one.seen_s)) * one.size for one in self.active]
        jumps = np.array([*map(_apart, points, expected)])
        points[(number_near < MIN_NEAR * number_known) | (jumps > limits)] = np.nan
        return [*points]

    def _points(
        self, pixels: Array, sizes: Array, near: Array, starts: Sequence[Array | None] = (None,)
    ) -> list[Array]:
        """Locate the joints (n, joints, 3) of individuals by pixels (cameras, n, joints, 2), from each start.

        `near` are joints in about the right depth; `starts`: see `locate`.
        """
        cameras, number, joints = pixels.shape[:3]
        depths = np.stack([np.nanmean(to_pixels(one, near)[1], axis=1) for one in self.projections])
        noise = NOISE * sizes * self.sizes[:, None] / np.maximum(depths, 1e-9)
        variances = np.repeat(noise**2, joints, axis=1)
        measured = self.projections, pixels.reshape(cameras, -1, 2), variances
        return [locate(*measured, start).points.reshape(number, joints, 3) for start in starts]

    def _accept(
        self,
        individual: Individual,
        points: Array,
        places: dict[int, list[int]],
        frames: Mapping[int, int],
        seen: Mapping[int, Detections],
        now_s: float,
    ) -> bool:
        """Move an individual to its detections, without those that do not fit; False if none agree."""
        for camera in list(places):
            if self._residual(camera, points, individual.size, seen[camera], places[camera]) > 2 * AGREE:
                del places[camera]
        known = np.isfinite(points[:, 0])
        if len(places) < 2 or known.sum() < min(MIN_SHARED, len(points)):
            return False
        step = np.nanmedian(points - individual.joints, axis=0)
        unseen_s = now_s - individual.seen_s
        if unseen_s > 0:
            step = np.where(np.isfinite(step), step, 0.0) / unseen_s
            individual.speed = individual.speed + (step - individual.speed) * 0.4
        individual.joints = np.where(known[:, None], points, individual.at(now_s))
        individual.known_s = np.where(known, now_s, individual.known_s)
        individual.joints[now_s - individual.known_s > MAX_LOST_S] = np.nan
        individual.size += 0.1 * (max(_extent(individual.joints), individual.size * 0.9) - individual.size)
        individual.seen_s = now_s
        individual.confirmed.append(self.step)
        for camera, owned in places.items():
            individual.places[camera, frames[camera]] = owned
            if seen[camera].names:
                individual.names[camera] = seen[camera].names[owned[0]]
        return True

    def _residual(self, camera: int, points: Array, size: float, seen: Detections, owned: list[int]) -> float:
        at, depth = to_pixels(self.projections[camera], points)
        distances = np.linalg.norm(at - merged(seen, owned)[0], axis=1) * depth / (size * self.sizes[camera])
        known = distances[np.isfinite(distances)]
        return float(np.median(known)) if len(known) else np.inf

    def _follow(
        self, individual: Individual, camera: int, seen: Detections, place: int, now_s: float
    ) -> None:
        """Move an individual that one camera alone shows across that camera's view."""
        joints = individual.at(now_s)
        at, depth = to_pixels(self.projections[camera], joints)
        distance = np.nanmedian(
            np.where(seen.confidence[place][:, None] > 0, seen.pixels[place] - at, np.nan), axis=0
        )
        inverse = np.linalg.pinv(self.projections[camera][:, :3])
        shift = inverse @ np.append(distance * np.nanmean(depth), 0.0)
        individual.joints, individual.seen_s = joints + shift, now_s
        individual.speed = individual.speed * 0.8

    def _nearest(self, camera: int, individual: Individual, seen: Detections, time_s: float) -> Array:
        """Return the distances (n,) of an individual from detections, its sides exchanged or not."""
        joints, size = individual.at(time_s), individual.size
        as_it_is, exchanged = (
            self._distances(camera, sides, size, seen) for sides in (joints, joints[self.mirror])
        )
        return np.minimum(as_it_is, exchanged)

    def _end_ghosts(
        self, sure: list[int], apart: Mapping[int, Mapping[int, Array]], frames: Mapping[int, int]
    ) -> None:
        """End individuals whose detections are those of older ones.

        `sure` are the numbers of individuals, the oldest first; `apart` has their distances from each
        camera's detections.
        """
        older = list[int]()
        for number in sure[:]:
            individual = self.active[number]
            shown = {
                camera: places[0]
                for camera, k in frames.items()
                if (places := individual.places.get((camera, k)))
            }
            own = 0
            for camera, place in shown.items():
                limit = min(SHADE, MUCH_NEARER * max(NOISE, apart[camera][number][place]))
                own += all(apart[camera][other][place] > limit for other in older)
            individual.own += own > 1 or (own > 0 and len(shown) + 1 >= len(frames))
            if individual.own < MIN_OWN * len(individual.confirmed):
                sure.remove(number)
                individual.confirmed.pop()
                individual.seen_s = -np.inf
                for at in frames.items():
                    individual.places.pop(at, None)
            else:
                older.append(number)

    def _on_a_body(self, joints: Array, size: float, bodies: Sequence[tuple[Array, float]]) -> bool:
        """Whether joints (joints, 3) are on one of bodies (joints and size), its sides exchanged or not."""
        return any(
            min(_apart(joints, body), _apart(joints, body[self.mirror])) < ONE_BODY * max(size, big)
            for body, big in bodies
        )

    def _begin(
        self,
        seen: Mapping[int, Detections],
        free: Mapping[int, set[int]],
        frames: Mapping[int, int],
        weak: Sequence[Individual],
        sure: Sequence[Individual],
        now_s: float,
    ) -> None:
        """Make individuals of free detections whose rays agree: those seen before, or new ones."""
        found = list[tuple[Array, float, dict[int, list[int]]]]()
        for points, size, places in self._hypotheses(seen, free):
            others = [(one.joints, one.size) for one in sure] + [(joints, big) for joints, big, _ in found]
            if not self._on_a_body(points, size, others):
                found.append((points, size, places))
            for camera, owned in places.items():
                free[camera].difference_update(owned)
        gaps = np.full((len(found), len(weak)), np.inf)
        for row, (points, size, _) in enumerate(found):
            for column, one in enumerate(weak):
                distance = _apart(points, one.at(now_s)) / max(size, one.size)
                gaps[row, column] = distance / (DRIFT + STRIDE * (now_s - one.seen_s))
        again = dict(assign(gaps, 1.0))
        for row, (points, size, places) in enumerate(found):
            if row in again:
                one = weak[again[row]]
                one.size = max(one.size, size)
            else:
                one = Individual(points, np.full(len(points), now_s), now_s, size, np.zeros(3))
                self.active.append(one)
            self._accept(one, points, dict(places), frames, seen, now_s)

    def _hypotheses(
        self, seen: Mapping[int, Detections], free: Mapping[int, set[int]]
    ) -> list[tuple[Array, float, dict[int, list[int]]]]:
        """Return joints, size and detections of individuals by free detections, the best first, each once."""
        pool = [(camera, place) for camera, places in free.items() for place in sorted(places)]
        pairs = [(a, b) for a, b in combinations(pool, 2) if a[0] != b[0]]
        left, found = {*pool}, list[tuple[Array, float, dict[int, list[int]]]]()
        scored = [one for pair in pairs if (one := self._supported(pair, seen, pool)) is not None]
        for _, places in sorted(scored, key=lambda one: -one[0]):
            if left.issuperset(places.items()):
                pixels = np.full(
                    (len(self.projections), 1, *next(iter(seen.values())).pixels.shape[1:]), np.nan
                )
                for camera, place in places.items():
                    pixels[camera, 0] = merged(seen[camera], [place])[0]
                rough = self._pair([*places.items()][:2], seen)
                points = self._points(pixels, np.array([_extent(rough)]), rough[None])[0][0]
                if np.isfinite(points[:, 0]).sum() >= min(MIN_SHARED, len(points)):
                    left -= {*places.items()}
                    found.append(
                        (
                            points,
                            self._size(points, places, seen),
                            {camera: [place] for camera, place in places.items()},
                        )
                    )
        return found

    def _size(self, points: Array, places: Mapping[int, int], seen: Mapping[int, Detections]) -> float:
        """Return an individual's size by all joints of its detections, also those of one camera."""
        depths = {
            camera: float(np.nanmean(to_pixels(self.projections[camera], points)[1])) for camera in places
        }
        sizes = [
            _extent(seen[camera].pixels[place]) * depths[camera] / self.sizes[camera]
            for camera, place in places.items()
        ]
        return max(_extent(points), float(np.median(sizes)))

    def _pair(self, pair: Sequence[tuple[int, int]], seen: Mapping[int, Detections]) -> Array:
        """Return the joints (joints, 3) of a detection in each of two cameras."""
        (a, one), (b, other) = pair
        pixels = [np.nan_to_num(seen[camera].pixels[place]) for camera, place in pair]
        both = (seen[a].confidence[one] > 0) & (seen[b].confidence[other] > 0)
        flat = cv2.triangulatePoints(self.projections[a], self.projections[b], pixels[0].T, pixels[1].T)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(both[:, None], (flat[:3] / flat[3]).T, np.nan)

    def _supported(
        self,
        pair: tuple[tuple[int, int], tuple[int, int]],
        seen: Mapping[int, Detections],
        pool: Sequence[tuple[int, int]],
    ) -> tuple[float, dict[int, int]] | None:
        """Return how well cameras support that two detections are one individual, and its detections."""
        joints = self._pair(pair, seen)
        known = np.isfinite(joints[:, 0])
        if known.sum() < min(MIN_SHARED, len(joints)):
            return None
        score, places = 0.0, dict(pair)
        for camera, one in seen.items():
            at, depth = to_pixels(self.projections[camera], joints)
            if not (depth[known] > 0).all():
                if camera in places:
                    return None
                continue
            distances = np.linalg.norm(at - one.pixels, axis=2) / _extents(one.pixels)[:, None]
            mean = _mean_distances(distances, np.isfinite(distances) & (one.confidence > 0))
            if camera in places:
                if mean[places[camera]] > AGREE:
                    return None
                score += 1 - mean[places[camera]] / GATE
                continue
            mean[[place for place in range(len(mean)) if (camera, place) not in pool]] = np.inf
            best = int(mean.argmin())
            if mean[best] < GATE:
                places[camera] = best
                score += 1 - mean[best] / GATE
            else:
                score -= UNSEEN
        return (score, places) if score > 0 else None


def _joined(paths: Mapping[Individual, Path]) -> dict[Individual, Path]:
    """Return individuals, of which those are one that take turns in the same place."""
    whole = dict[Individual, Path]()
    for one, path in sorted(paths.items(), key=lambda item: -len(item[1])):
        for other, longer in whole.items():
            if _take_turns(path, longer, max(one.size, other.size)):
                other.places = one.places | other.places
                other.confirmed = sorted({*other.confirmed, *one.confirmed})
                other.own += one.own - 1
                whole[other] = sorted([*path, *longer], key=lambda item: item[0])
                break
        else:
            whole[one] = path
    return whole


def _take_turns(path: Path, longer: Path, size: float) -> bool:
    """Whether two paths are one body's: seldom at the same time, and each goes on where the other ends."""
    if len({at_s for at_s, *_ in path} & {at_s for at_s, *_ in longer}) > MAX_BOTH * len(path):
        return False
    turns = sorted(
        [(at_s, 0, joints) for at_s, joints, _ in path] + [(at_s, 1, joints) for at_s, joints, _ in longer],
        key=lambda item: item[:2],
    )
    apart = [
        _apart(joints, others) / (DRIFT + STRIDE * (after_s - before_s))
        for (before_s, owner, joints), (after_s, next_owner, others) in pairwise(turns)
        if owner != next_owner and after_s - before_s <= MAX_LOST_S
    ]
    return bool(apart) and float(np.median(apart)) < size


def merged(seen: Detections, owned: Sequence[int]) -> tuple[Array, Array, Array]:
    """Return pixels, confidences and times (joints, ...) of one individual's detections."""
    pixels, confidence, times = (
        np.array(part[owned[0]]) for part in (seen.pixels, seen.confidence, seen.times_s)
    )
    for place in owned[1:]:
        lacking = (confidence == 0) & (seen.confidence[place] > 0)
        for whole, part in ((pixels, seen.pixels), (confidence, seen.confidence), (times, seen.times_s)):
            whole[lacking] = part[place][lacking]
    return pixels, confidence, times


def mirrored(joints: Sequence[str]) -> Array:
    """Return for each joint the number of that on the other side, by its name; its own if there is none."""
    left_right = [
        ("left", "right"),
        ("right", "left"),
        ("Left", "Right"),
        ("Right", "Left"),
        ("L", "R"),
        ("R", "L"),
    ]
    others = [[re.sub(rf"^{a}(?![a-z])|(?<=_){a}$", b, name) for a, b in left_right] for name in joints]
    return np.array([next((joints.index(other) for other in names if other != name and other in joints), k)
        for k, (name, names) in enumerate(zip(joints, others, strict=True))])  # fmt: skip


def _steps(frame_s: Sequence[Array], period_s: float) -> list[dict[int, int]]:
    """Return the frames of each step in time, by camera: each frame once, a camera once in a step."""
    frames = sorted(
        (float(s), camera, k)
        for camera, times in enumerate(frame_s)
        for k, s in enumerate(times)
        if np.isfinite(s)
    )
    shortest = min(
        (float(np.median(np.diff(own))) for times in frame_s if len(own := times[np.isfinite(times)]) > 1),
        default=period_s,
    )
    steps, begin = list[dict[int, int]](), -np.inf
    for at_s, camera, k in frames:
        if not steps or camera in steps[-1] or at_s - begin > STEP * shortest:
            steps.append({})
            begin = at_s
        steps[-1][camera] = k
    return steps


def _mean_distances(distances: Array, shared: Array) -> Array:
    """Return the means (n,) of the shared distances (n, joints); infinite where too few are shared."""
    number = shared.sum(axis=1)
    mean = np.where(shared, np.minimum(distances, CAP), 0).sum(axis=1) / np.maximum(number, 1)
    return np.where(number >= min(MIN_SHARED, shared.shape[1]), mean, np.inf)


def _extents(joints: Array) -> Array:
    """Return the sizes (n,) of individuals' joints, at least 1e-9."""
    return np.fmax(size_of(joints), 1e-9)


def _extent(joints: Array) -> float:
    return float(_extents(joints[None])[0])


def _apart(a: Array, b: Array) -> float:
    """Return the median distance of the joints that both know; infinite where there are none."""
    distances = np.linalg.norm(a - b, axis=1)
    known = distances[np.isfinite(distances)]
    return float(np.median(known)) if len(known) else np.inf
