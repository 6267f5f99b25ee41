"""People of a session in 3D, at its instants or at any other times."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from capture_app.common.grouping import grouped
from capture_app.common.text import count
from reconstruction.common.geometry import SIGMAS_95, Array, View
from reconstruction.methods.people.joint_positions import JointLocator, Person
from reconstruction.methods.people.joint_tracks import (
    MIN_CONFIDENCE,
    PixelsAt,
    interpolate,
    stack,
)
from reconstruction.methods.people.keypoints import CameraJoints, FrameJoints, Keypoints
from reconstruction.methods.people.person_matching import Detections, Individual, PersonMatcher
from reconstruction.methods.people.skeletons import Skeleton
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.camera_time import ImageTimes

MIN_JOINTS = 0.2
"""Fraction of joints that an individual needs at some time."""
UNSURE = 0.15
"""Error of a joint relative to the person's size from which it is unsure: a ring, as in skeletons.js."""


class CameraFrames(NamedTuple):
    """A camera's view, the times of its frames and rows, and the joints in them.

    `frame_s` (frames,) are since the first instant, NaN without a frame; `row_s` is the time from row to row;
    `error_s` the standard deviation of its times.
    """

    view: View
    frame_s: Array
    row_s: float
    error_s: float
    joints: CameraJoints


def camera_frames(
    dataset: Dataset, views: Mapping[str, View], keypoints: Keypoints
) -> dict[str, CameraFrames]:
    """Return the frames of all calibrated cameras, with their joints.

    A joint's time is the middle of its row's exposure if all cameras report it, else its frame's. An
    instant is then the middle of the exposures of the images' middle rows.
    """
    filmed = {
        name: there for name in views if name in keypoints.cameras and (there := dataset.instants(name))
    }
    times, frames = ImageTimes(dataset, [*filmed]), dict[str, CameraFrames]()
    images = [(name, k) for name, there in filmed.items() for k in there]
    middle_ms = float(np.median([times.middle_ms(*image) - times.at_ms(*image) for image in images]))
    for name, instants in filmed.items():
        rows_ms = np.array([times.of_rows_ms(name, k, np.arange(2)) for k in instants])
        frame_s = np.full(len(dataset.instants_ns), np.nan)
        frame_s[list(instants)] = (rows_ms[:, 0] - middle_ms) / 1e3
        row_s = float(np.median(np.diff(rows_ms))) / 1e3
        error_s = max(dataset.record(name, k).uncertainty_ns or 0 for k in instants) / 1e9 / SIGMAS_95
        frames[name] = CameraFrames(views[name], frame_s, row_s, error_s, keypoints.cameras[name])
    return frames


def unsure_joints(positions: Array, error: Array) -> Array:
    """Return which joints (..., joints) have a large error for the person's size; gaps have none.

    `positions` is (..., joints, 3), NaN = unknown.
    """
    known = np.isfinite(positions)
    extent = np.where(known, positions, -np.inf).max(axis=-2) - np.where(known, positions, np.inf).min(
        axis=-2
    )
    return np.asarray(error > UNSURE * np.linalg.norm(extent, axis=-1, keepdims=True))


@dataclass(frozen=True, eq=False)
class PeopleInTime:
    """The people of a session at times (n,), s since its first instant."""

    skeleton: Skeleton
    times_s: Array
    people: Sequence[Person]
    noise_px: float
    """Median standard deviation of a joint's pixel."""
    moved_ms: float
    """Median time from the nearest frame."""
    moved_px: float
    """95th percentile of the distances that joints moved in it, px."""


class PeopleFinder:
    """The individuals of a session in all cameras, matched once; `at` locates their joints."""

    def __init__(
        self,
        cameras: Mapping[str, CameraFrames],
        skeleton: Skeleton,
        period_s: float,
        scale_error: float = 0.0,
        bias: Array | None = None,
    ) -> None:
        """Match who is who. `bias` (joints,) is the detector's: see `detector_bias`."""
        self.names, self.frames = tuple(cameras), tuple(cameras.values())
        self.skeleton, self.period_s = skeleton, period_s
        found = [_detections(one) for one in self.frames]
        errors_s = np.array([one.error_s for one in self.frames])
        self.locator = JointLocator([one.view for one in self.frames], bias, errors_s, scale_error)
        self.seen = {
            camera
            for camera, of_frames in enumerate(found)
            if any(len(one.pixels) for one in of_frames.values())
        }
        """Cameras, by number, that show anybody."""
        matcher = PersonMatcher(self.locator.projections, self.locator.focal, found, skeleton.joints)
        frame_s = [one.frame_s for one in self.frames]
        individuals = matcher.match(frame_s, period_s)
        self.people = [
            matcher.tracks(one, [*map(len, frame_s)])
            for one in sorted(individuals, key=lambda one: -len(one.confirmed))
        ]
        owned = sum(len(places) for one in individuals for places in one.places.values())
        self.alone = sum(len(one.pixels) for frames in found for one in frames.values()) - owned
        """Number of detections that no second camera confirms."""
        self.remarks = [*_cut_names(self.names, found, individuals)]
        """What space contradicts in the names of a source."""

    def at(
        self, times_s: Array, late_s: Mapping[str, Array] | None = None, *, nearest: bool = False
    ) -> PeopleInTime:
        """Locate the joints of all people at times (n,), s since the first instant.

        `late_s` are delays (n,) by camera: each then shows what it saw that much later. `nearest` takes the
        nearest frames as they are.
        """
        seen = self.pixels_at(times_s, late_s or {}, nearest=nearest)
        people, noise = self.locator.locate_people(seen)
        moved = np.concatenate([one.moved[np.isfinite(one.pixels[..., 0])] for one in seen])
        apart_s = [np.nanmin(np.abs(one.frame_s[:, None] - times_s), axis=0) for one in self.frames]
        return PeopleInTime(
            skeleton=self.skeleton,
            times_s=times_s,
            people=[one for one in people if (np.isfinite(one.error).mean(axis=1) >= MIN_JOINTS).any()],
            noise_px=float(np.median(noise)),
            moved_ms=float(np.median(apart_s)) * 1e3,
            moved_px=float(np.percentile(moved, 95)) if len(moved) else 0.0,
        )

    def pixels_at(
        self, times_s: Array, late_s: Mapping[str, Array], *, nearest: bool = False
    ) -> list[PixelsAt]:
        """Return each person's pixels in all cameras at times (n,); arguments as in `at`."""
        return [
            stack([
                interpolate(track, times_s + late_s.get(name, 0.0), self.period_s, nearest=nearest)
                for track, name in zip(tracks, self.names, strict=True)
            ])
            for tracks in self.people
        ]  # fmt: skip


def detections_in(view: View, frame: FrameJoints, frame_s: float, row_s: float) -> Detections:
    """Return what is seen in a frame of this time, without what is outside the image or unsure."""
    inside = (np.abs((frame.pixels + 0.5) / (view.width, view.height) - 0.5) < 0.5).all(axis=2)
    inside &= frame.confidence >= MIN_CONFIDENCE
    straight = np.full(frame.pixels.shape, np.nan)
    straight[inside] = view.undistort(frame.pixels[inside])
    times = np.where(inside, frame_s + row_s * frame.pixels[..., 1], np.nan)
    return Detections(times, straight, np.where(inside, frame.confidence, 0.0), frame.names)


def _detections(camera: CameraFrames) -> dict[int, Detections]:
    """Return what is seen in a camera's frames that have a time."""
    return {
        k: detections_in(camera.view, frame, float(camera.frame_s[k]), camera.row_s)
        for k, frame in camera.joints.items()
        if k < len(camera.frame_s) and np.isfinite(camera.frame_s[k])
    }


def _cut_names(
    cameras: Sequence[str], found: Sequence[Mapping[int, Detections]], individuals: Sequence[Individual]
) -> Iterator[str]:
    """Yield a remark for each name in a camera that is not one individual throughout."""
    owners = grouped(
        ((camera, found[camera][k].names[place]), (k, number))
        for number, one in enumerate(individuals)
        for (camera, k), places in one.places.items()
        for place in places
        if found[camera][k].names
    )
    for (camera, name), owned in sorted(owners.items()):
        changed = [k for (_, before), (k, after) in pairwise(sorted(owned)) if before != after]
        if changed:
            often = f" ({count(len(changed), 'change')})" if len(changed) > 1 else ""
            where = f"in {cameras[camera]}, {name or 'the one without a name'}"
            yield f"{where} is another individual from instant {changed[0]} on{often}: the name was cut there"
