"""The result of people in 3D: its files, what is printed, and its arrays in Python."""

from functools import cached_property
from pathlib import Path

import msgspec
import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.common.text import count
from reconstruction.common.geometry import Array
from reconstruction.common.outputs import Made
from reconstruction.methods.people.detector_bias import detector_bias
from reconstruction.methods.people.joint_formats import rate_of
from reconstruction.methods.people.joint_positions import Person
from reconstruction.methods.people.joint_times import describe_late_cameras
from reconstruction.methods.people.people_files import (
    COLUMNS,
    SMOOTHED,
    file_names,
    write_formats,
    write_table,
)
from reconstruction.methods.people.people_options import PeopleOptions
from reconstruction.methods.people.people_page import write_people_page
from reconstruction.methods.people.people_pictures import write_films, write_pictures, write_plots
from reconstruction.methods.people.people_run import PeopleFinder, PeopleInTime, unsure_joints
from reconstruction.methods.people.people_scene import (
    UPS,
    describe_axes,
    find_people,
    people_at,
    up_axes,
)
from reconstruction.scene.conditions import Condition
from reconstruction.scene.provenance import Provenance
from reconstruction.scene.scene import Scene

TABLE, PAGE, PICTURES, FILMS, PLOTS = "people.csv", "people.html", "pictures", "films", "plots"
OURS = {TABLE, SMOOTHED, PICTURES, FILMS, PLOTS, PAGE} | file_names()
"""Names of the result's files and folders, also of installed formats."""


class PersonResult(msgspec.Struct, frozen=True, kw_only=True):
    """One individual, numbered from 1 as in the files."""

    person: int
    known: float
    """Fraction of its joints, over all times, that are known; the others are gaps."""
    first_s: float
    last_s: float
    error: float
    """Median error of a known joint, in the calibration's unit: 95 %, where `bias_source` is known."""
    reprojection_px: float
    """Median over its joints of the root mean square distance in the images."""
    cameras: float
    """Mean number of cameras that a known joint is from."""
    unsure: float = 0.0
    """Fraction of its known joints that are gaps in TRC, C3D and glTF, as their error is large."""


class PeopleResult(Provenance, frozen=True, kw_only=True):
    """People in 3D; written to people.json and printed by --json."""

    session: str
    source: str
    """What found the joints in images."""
    condition: str
    unit: str
    axes: str
    """Axes of TRC, C3D and glTF; the table has the calibration's own."""
    cameras: tuple[str, ...]
    joints: tuple[str, ...]
    times: int
    rate_hz: float
    noise_px: float
    """Median standard deviation of a joint's pixel, as the residuals show it."""
    moved_ms: float
    """Median time from the nearest frame to the instant, over which joints were interpolated."""
    moved_px: float
    """95th percentile of the distances that joints moved in that time."""
    people: tuple[PersonResult, ...]
    bias_source: str = ""
    """On what the detector's bias was measured, which is in the errors; empty: it is in no error."""
    left_out: dict[str, str]
    remarks: tuple[str, ...] = ()


class MadePeople(Made[PeopleResult]):
    """People in 3D, with arrays by joint."""

    @cached_property
    def times_s(self) -> Array:
        """Times (n,) at which a joint of anybody is known, s since the session's first instant."""
        return np.unique(self._rows["time_s"])

    def positions(self, person: int = 1) -> Array:
        """Return positions (n, joints, 3) of a person, in the calibration's axes and unit; NaN = unknown."""
        return np.stack([self._of(person, axis) for axis in "xyz"], axis=2)

    def errors(self, person: int = 1) -> Array:
        """Return the errors (n, joints) of a person's positions; NaN = unknown.

        They hold the truth in 95 % of cases if `result.bias_source` is known, else the precision alone.
        """
        return self._of(person, "error")

    def _of(self, person: int, column: str) -> Array:
        own = self._rows[self._rows["person"] == person]
        values = np.full((len(self.times_s), len(self.result.joints)), np.nan)
        joints = [self.result.joints.index(name) for name in own["joint"]]
        values[np.searchsorted(self.times_s, own["time_s"]), joints] = own[column]
        return values

    @cached_property
    def _rows(self) -> Array:
        kinds = [(name, "U64" if name == "joint" else "f8") for name in COLUMNS]
        return np.loadtxt(self.folder / TABLE, kinds, delimiter=",", skiprows=1, ndmin=1)


def save_people(scene: Scene, condition: Condition, folder: Path, method: PeopleOptions) -> PeopleResult:
    """Locate the people of a session, and write them in all formats into a folder.

    Raises:
        NotApplicableError: nobody is seen by two cameras.
        SimulshotError: there are no joints, no calibration, or no such instants.
    """
    if method.up not in UPS:
        raise BadInputError(f"--up {method.up} is not an axis", hint=", ".join(UPS))
    scene.dataset.require_cameras(2, "a joint in 3D needs two cameras that see it")
    method.progress.total = (method.keypoints is None) * len(scene.views) + 1 + method.film
    finder, keypoints = find_people(scene, method)
    people = people_at(scene, finder, condition, method)
    method.progress.step(f"{count(len(people.people), 'individual')} at {len(people.times_s)} times")
    rotation = up_axes(scene, method.up)
    bias_source = detector_bias(people.skeleton)[1]
    formats_left_out = _write(folder, scene, people, rotation, method, bias_is_known=bool(bias_source))
    left_out = _left_out(finder)
    return PeopleResult(
        session=scene.dataset.name,
        source=keypoints.source,
        condition=condition.name,
        unit=scene.unit,
        axes=describe_axes(rotation),
        cameras=tuple(name for name in finder.names if name not in left_out),
        joints=people.skeleton.joints,
        times=len(people.times_s),
        rate_hz=round(rate_of(people.times_s), 4),
        noise_px=round(people.noise_px, 3),
        moved_ms=round(people.moved_ms, 4),
        moved_px=round(people.moved_px, 3),
        people=tuple(_summary(k, person, people.times_s) for k, person in enumerate(people.people, 1)),
        bias_source=bias_source,
        left_out=left_out,
        remarks=(
            *_remarks(finder),
            *describe_late_cameras(finder, people.times_s),
            *dict.fromkeys(formats_left_out),
        ),
    )


def _write(
    folder: Path,
    scene: Scene,
    people: PeopleInTime,
    rotation: Array,
    options: PeopleOptions,
    *,
    bias_is_known: bool,
) -> list[str]:
    """Write all files; return what was left out, in sentences."""
    times_s = people.times_s
    write_table(folder / TABLE, times_s, people.skeleton, people.people, bias_is_known=bias_is_known)
    # These formats have no place for an error, so that unsure joints are gaps there.
    sure = [
        np.where(unsure_joints(person.positions, person.error)[..., None], np.nan, person.positions)
        for person in people.people
    ]
    upright = [positions @ rotation.T for positions in sure]
    left_out = write_formats(folder, times_s, people.skeleton, upright, scene.unit, options.smooth)
    write_plots(folder / PLOTS, people, rotation[1], scene.unit)
    still = write_pictures(folder / PICTURES, scene.dataset, scene.views, people)
    write_people_page(folder / PAGE, scene.dataset.name, people, scene.views, still)
    if options.film:
        options.progress.step("films")
        write_films(folder / FILMS, scene.dataset, scene.views, people)
    return left_out


def _summary(number: int, person: Person, times_s: Array) -> PersonResult:
    known = np.isfinite(person.error)
    seen = times_s[known.any(axis=1)]
    return PersonResult(
        person=number,
        known=round(float(known.mean()), 4),
        first_s=round(float(seen[0]), 6),
        last_s=round(float(seen[-1]), 6),
        error=float(f"{np.median(person.error[known]):.4g}"),
        reprojection_px=round(float(np.median(person.residual_px[known])), 3),
        cameras=round(float(person.cameras[known].mean()), 3),
        unsure=round(float(unsure_joints(person.positions, person.error)[known].mean()), 4),
    )


def _remarks(finder: PeopleFinder) -> tuple[str, ...]:
    alone = f"left out, as no second camera confirms them: {count(finder.alone, 'detection')}"
    unknown = "the errors are of precision alone: the bias of this detector was never measured"
    remarks = (
        (alone, finder.alone),
        *((note, 1) for note in finder.remarks),
        (unknown, not finder.locator.bias.any()),
    )
    return tuple(note for note, applies in remarks if applies)


def _left_out(finder: PeopleFinder) -> dict[str, str]:
    """Return the cameras that show nobody whom another camera confirms, each with the reason."""
    used = {track.camera for tracks in finder.people for track in tracks if track.frames.any()}
    odd = "who is seen in it fits no other camera: is its calibration its own, and its picture not mirrored?"
    return {
        name: odd if number in finder.seen else "nobody is seen in it"
        for number, name in enumerate(finder.names)
        if number not in used
    }
