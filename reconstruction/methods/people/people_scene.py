"""People of a session: its joints, found or read, and where they are under a condition."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from capture_app.common.errors import NotApplicableError
from reconstruction.common.geometry import Array
from reconstruction.methods.people.detector_bias import detector_bias
from reconstruction.methods.people.joint_files import read_keypoints
from reconstruction.methods.people.joint_positions import Person
from reconstruction.methods.people.keypoints import Keypoints, detect_people
from reconstruction.methods.people.people_options import PeopleOptions
from reconstruction.methods.people.people_run import PeopleFinder, PeopleInTime, camera_frames
from reconstruction.methods.people.skeletons import Skeleton
from reconstruction.scene.conditions import SYNCHRONIZED, Condition
from reconstruction.scene.instant_choice import instants_shown
from reconstruction.scene.scene import Scene

UPS = ("auto", "x", "y", "z", "-x", "-y", "-z")
"""Values of `--up`."""
WHOLE = "two cameras at least must see a person whole and large, from different sides; or give --keypoints"


class PeopleInstant(NamedTuple):
    """The people of one instant: a `Person` whose arrays have the people in place of the times."""

    instant: int
    skeleton: Skeleton
    joints: Person


def find_people(scene: Scene, method: PeopleOptions) -> tuple[PeopleFinder, Keypoints]:
    """Return the individuals of all cameras, matched once for all runs of a scene, and their joints in them.

    Raises:
        NotApplicableError: fewer than two cameras are calibrated, or nobody is seen by two of them.
        SimulshotError: there are no joints, or no calibration.
    """
    key = "people", method.keypoints, method.label_start, method.detector, method.model
    return scene.once(key, lambda: _find_people(scene, method))


def _find_people(scene: Scene, method: PeopleOptions) -> tuple[PeopleFinder, Keypoints]:
    dataset = scene.dataset
    if len(cameras := list(scene.views)) < 2:
        raise NotApplicableError(
            f"only {' and '.join(cameras) or 'no camera'} is calibrated; a joint in 3D needs two cameras",
            hint="calibrate the session: reconstruct calibrate SESSION",
        )
    if method.keypoints is None:
        keypoints = detect_people(dataset, cameras, method.detector, method.model, method.progress)
    else:
        keypoints = read_keypoints(Path(method.keypoints), dataset, cameras, method.label_start)
    frames = camera_frames(dataset, scene.views, keypoints)
    bias, _ = detector_bias(keypoints.skeleton)
    finder = PeopleFinder(frames, keypoints.skeleton, dataset.period_ns / 1e9, scene.scale_error, bias)
    if not finder.people:
        seen = [finder.names[number] for number in sorted(finder.seen)]
        what = f"somebody is seen by {' and '.join(seen)}, but no two cameras see the same person"
        raise NotApplicableError(what if seen else f"nobody is seen by {' or '.join(cameras)}", hint=WHOLE)
    return finder, keypoints


def people_at(
    scene: Scene, finder: PeopleFinder, condition: Condition, method: PeopleOptions
) -> PeopleInTime:
    """Locate people at the instants that a method names, or at its rate, under a condition.

    Raises:
        NotApplicableError: nobody has joints at these times.
    """
    dataset = scene.dataset
    chosen = dataset.chosen_instants(method.instants)
    instants_s = (np.array(dataset.instants_ns, np.int64) - dataset.instants_ns[0]) / 1e9
    times_s = instants_s[chosen]
    if method.rate is not None:
        times_s = np.arange(times_s[0], times_s[-1] + 1e-9, 1 / method.rate)
    late_s = dict[str, Array]()
    if condition != SYNCHRONIZED:
        nearest = np.abs(instants_s[:, None] - times_s).argmin(axis=0)
        shown = [instants_shown(dataset, condition, int(k)) for k in nearest]
        late_s = {
            name: instants_s[[instants[name] for instants in shown]] - instants_s[nearest]
            for name in finder.names
        }
    found = finder.at(times_s, late_s, nearest=method.nearest)
    if not found.people:
        raise NotApplicableError("nobody has joints at these times that two cameras agree on", hint=WHOLE)
    return found


def instants_of_people(scene: Scene, condition: Condition, method: PeopleOptions) -> Iterator[PeopleInstant]:
    """Yield the people at each of a method's instants."""
    found = people_at(scene, find_people(scene, method)[0], condition, method)
    for number, instant in enumerate(scene.dataset.chosen_instants(method.instants)):
        people = zip(*([array[number] for array in person] for person in found.people), strict=True)
        yield PeopleInstant(instant, found.skeleton, Person(*map(np.array, people)))


def up_axes(scene: Scene, up: str) -> Array:
    """Return the rotation (3, 3) into right-handed axes with y up: the calibration's, permuted.

    `up` is the calibration's axis that points up; `auto` is the one nearest to the cameras' own.
    """
    if up == "auto":
        upwards = -np.mean([view.rotation[1] for view in scene.views.values()], axis=0)
        axis = int(np.abs(upwards).argmax())
        up = ("" if upwards[axis] > 0 else "-") + "xyz"[axis]
    axis, sign = "xyz".index(up[-1]), -1.0 if up.startswith("-") else 1.0
    rows = np.eye(3)[[(axis + 2) % 3, axis, (axis + 1) % 3]]
    return np.asarray(rows * np.array([1.0, sign, sign])[:, None])


def describe_axes(rotation: Array) -> str:
    """Describe `up_axes` for people: which axis of the calibration each of the file's is."""
    x, y, z = (f"{'-' * bool(row.sum() < 0)}{'xyz'[int(np.abs(row).argmax())]}" for row in rotation)
    return f"x = {x}, y (up) = {y}, z = {z} of the calibration"
