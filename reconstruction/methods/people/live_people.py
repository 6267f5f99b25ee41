"""People while they move: the joints of one instant after the other, from small pictures of all cameras."""

from collections import deque
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import cv2
import numpy as np

from capture_app.common import system
from capture_app.common.errors import NotApplicableError
from reconstruction.common.geometry import Array, View, resize_view
from reconstruction.methods.people.detector_bias import detector_bias
from reconstruction.methods.people.joint_positions import (
    JointLocator,
    locate_with_jackknife,
    pixel_noise,
    squared_noise,
)
from reconstruction.methods.people.joint_tracks import PixelsAt
from reconstruction.methods.people.keypoints import FrameJoints, load_detector
from reconstruction.methods.people.people_run import MIN_JOINTS, detections_in
from reconstruction.methods.people.person_matching import (
    MAX_LOST_S,
    Detections,
    Individual,
    PersonMatcher,
    merged,
)

REMEMBERED = 150
"""Number of latest positions of a joint whose residuals show the noise of its pixels."""
SEARCH_EVERY_S = 1.0
"""Time after which new people are looked for, which costs as much as following one for four instants."""
CALIBRATION = "the rig is not calibrated for two of these cameras"


class PersonNow(NamedTuple):
    """A person at one instant: positions (joints, 3), NaN = unknown, and errors (joints,), as in `Person`.

    `number` counts from 1 and belongs to a person as long as they are followed.
    """

    number: int
    positions: Array
    error: Array


class LivePeople:
    """The people that a calibrated rig sees, from images of one instant after the other.

    Nothing is smoothed, and no later image is waited for. Cameras must show one instant: a joint's speed is
    unknown, so that no error of time is in the errors.
    """

    def __init__(
        self, views: Mapping[str, View], width_px: int = 640, detector: str = "blazepose", model: str = ""
    ) -> None:
        """`views`: the cameras' calibrated views; `width_px`: width of their images.

        Raises:
            NotApplicableError: fewer than two cameras are calibrated.
            SimulshotError: the detector, its runtime or its weights are not on this machine.
        """
        if len(views) < 2:
            raise NotApplicableError(CALIBRATION, hint="calibrate the rig: reconstruct calibrate")
        self.views = {
            name: resize_view(view, width_px, round(view.height * width_px / view.width))
            for name, view in views.items()
        }
        kind = load_detector(detector, model)
        self.skeleton = kind.skeleton
        self._detectors = {name: kind(model or next(iter(kind.models), "")) for name in views}
        for each in self._detectors.values():
            each.search_every_s = SEARCH_EVERY_S
        self._pool = ThreadPoolExecutor(max(1, len(system.usable_cores())))
        bias = detector_bias(self.skeleton)[0]
        self._locator = locator = JointLocator([*self.views.values()], bias, np.zeros(len(views)))
        self._seen: list[dict[int, Detections]] = [{} for _ in views]
        self._matcher = PersonMatcher(locator.projections, locator.focal, self._seen, self.skeleton.joints)
        self._numbers = dict[Individual, int]()
        self._last_s, self._steps = -np.inf, 0
        """Time of the last instant, and number of instants since a long pause."""
        self._squared = deque[Array]([np.full(len(self.skeleton.joints), np.nan)], maxlen=REMEMBERED)
        """Squares (joints,) of a pixel's error, px, of a camera of median focal length, NaN = unknown."""

    def find(self, images: Mapping[str, Array], at_s: float) -> list[PersonNow]:
        """Return the people of one instant, a time in s, by the images (BGR uint8) that show it."""
        step = self._matcher.step + 1
        self._steps = self._steps + 1 if at_s - self._last_s <= MAX_LOST_S else 1
        self._last_s = at_s
        shown = [(number, name) for number, name in enumerate(self.views) if name in images]
        joints = self._pool.map(lambda camera: self._detect(camera[1], images[camera[1]], at_s), shown)
        for (number, name), detected in zip(shown, joints, strict=True):
            self._seen[number].clear()
            self._seen[number][step] = detections_in(self.views[name], FrameJoints(*detected), at_s, 0.0)
        frames = {number: step for number, _ in shown}
        self._matcher.follow(frames, dict.fromkeys(frames, at_s))
        self._matcher.ended.clear()
        self._numbers = {person: n for person, n in self._numbers.items() if person in self._matcher.active}
        people = [
            person
            for person in self._matcher.active
            if person.confirmed[-1:] == [step] and person.is_somebody(self._steps)
        ]
        return [self._locate(person, step) for person in people]

    def _detect(self, name: str, image: Array, at_s: float) -> tuple[Array, Array]:
        view = self.views[name]
        if image.shape[:2] != (view.height, view.width):
            image = cv2.resize(image, (view.width, view.height), interpolation=cv2.INTER_AREA)
        return self._detectors[name].detect(image, at_s)

    def _locate(self, person: Individual, step: int) -> PersonNow:
        """Return an individual's joints by the detections that it has now."""
        if person not in self._numbers:
            taken = {*self._numbers.values()}
            self._numbers[person] = next(n for n in range(1, len(taken) + 2) if n not in taken)
        shape = len(self.views), 1, len(self.skeleton.joints)
        pixels, confidence, none = np.full((*shape, 2), np.nan), np.zeros(shape), np.zeros(shape)
        for (camera, k), places in person.places.items():
            if k == step:
                pixels[camera, 0], confidence[camera, 0], _ = merged(self._seen[camera][k], places)
        person.places.clear()
        noise = pixel_noise(np.array(self._squared), pixels[:, 0])
        seen = PixelsAt(pixels, confidence, none + 1, none, none, none)
        located = locate_with_jackknife(*self._locator.measured(seen, noise))
        self._squared.extend(squared_noise(located, noise))
        now = self._locator.person(located, shape[1:])
        positions = np.where((now.cameras > 0).mean() >= MIN_JOINTS, now.positions[0], np.nan)
        return PersonNow(self._numbers[person], positions, now.error[0])
