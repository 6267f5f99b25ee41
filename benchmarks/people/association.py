"""People counted in drawn scenes, beside Pose2Sim's association of the same detections. Simulated.

At each instant: whether there are as many persons as two cameras show, how many of these are missing, and how
many located persons are nobody or a second time somebody. Pose2Sim (`make readers`) associates each instant
by itself, with its default thresholds; it tracks and fills gaps later, which is left out here. Its persons
are located as ours are.
"""

import contextlib
import importlib
import io
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from benchmarks.people.figure import JOINTS, Floats
from benchmarks.people.scenes import KINDS, SceneOfPeople, draw_take, locate_people
from benchmarks.people.scores import SAME_M
from benchmarks.report import Columns, Report, new_parser, print_report, print_rows
from capture_app.common.optional_packages import is_here
from reconstruction.methods.people.assignment import assign
from reconstruction.methods.people.joint_positions import locate
from reconstruction.methods.people.people_run import MIN_JOINTS

POSE2SIM = "Pose2Sim.personAssociation"
RIGS = (3, 4, 5)
COLUMNS: Columns = {
    "kind": ("scenes", ""),
    "by": ("by", ""),
    "instants": ("instants", "d"),
    "right": ("counted right", ".1%"),
    "present": ("persons", "d"),
    "missing": ("missing", ".1%"),
    "extra": ("too many", ".1%"),
}


class Counts(NamedTuple):
    """Instants, those with the right number of persons, true persons, missing ones, and ones too many."""

    instants: int
    right: int
    present: int
    missing: int
    extra: int

    def figures(self) -> dict[str, float]:
        """Return the figures of a report, fractions from 0 to 1 of the instants and the true persons."""
        return {
            "instants": self.instants,
            "right": self.right / self.instants,
            "present": self.present,
            "missing": self.missing / self.present,
            "extra": self.extra / self.present,
        }


def total(counts: Sequence[Counts]) -> Counts:
    """Return the sum of counts."""
    return Counts(*np.sum(counts, axis=0).tolist())


def count_people(scene: SceneOfPeople, located: Sequence[Floats]) -> Counts:
    """Return counts of the persons (persons, joints, 3), m, NaN = unknown, that are located at each time."""
    right = present = missing = extra = 0
    for k, persons in enumerate(located):
        there = np.flatnonzero((scene.visible[:, k] & np.isfinite(scene.truth[:, k]).all(axis=2)).any(axis=1))
        apart = np.linalg.norm(scene.truth[there, k][:, None] - persons[None], axis=3)
        known = np.isfinite(apart).any(axis=2)
        costs = np.full(known.shape, np.inf)
        costs[known] = np.nanmedian(apart[known], axis=1)
        paired = len([*assign(costs, SAME_M)])
        right += len(persons) == len(there)
        present += len(there)
        missing += len(there) - paired
        extra += len(persons) - paired
    return Counts(len(located), right, present, missing, extra)


def located_by_simulshot(scene: SceneOfPeople) -> list[Floats]:
    """Return the persons (persons, joints, 3), m, at each time."""
    people = locate_people(scene)
    positions = np.array([person.positions for person in people]).reshape(len(people), -1, len(JOINTS), 3)
    return [each[np.isfinite(each).any(axis=(1, 2))] for each in positions.transpose(1, 0, 2, 3)]


def located_by_pose2sim(scene: SceneOfPeople) -> list[Floats]:
    """Return the persons (persons, joints, 3), m, that Pose2Sim associates at each time."""
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder, "trial")
        _write_trial(scene, trial)
        _associate(trial)
        return [_located(scene, trial / "pose-associated", k) for k in range(len(scene.times_s))]


def _write_trial(scene: SceneOfPeople, trial: Path) -> None:
    """Write a trial of Pose2Sim's: the calibration, and a JSON of OpenPose's kind for each frame."""
    (trial / "calibration").mkdir(parents=True)
    (trial / "Config.toml").touch()
    tables = []
    for name, camera in scene.frames.items():
        view = camera.view
        tables += [
            f"[{name}]",
            f'name = "{name}"',
            f"size = [{view.width:.1f}, {view.height:.1f}]",
            f"matrix = {view.matrix.tolist()}",
            "distortions = [0.0, 0.0, 0.0, 0.0]",
            f"rotation = {cv2.Rodrigues(view.rotation)[0].ravel().tolist()}",
            f"translation = {view.translation.tolist()}",
        ]
        (folder := trial / "pose" / f"{name}_json").mkdir(parents=True)
        for k, seen in camera.joints.items():
            rows = np.concatenate([seen.pixels, seen.confidence[..., None]], axis=2)
            people = [{"pose_keypoints_2d": each.ravel().tolist()} for each in rows]
            (folder / f"{name}_{k:06}.json").write_text(json.dumps({"people": people}), encoding="utf-8")
    (trial / "calibration" / "Calib.toml").write_text("\n".join(tables), encoding="utf-8")


def _associate(trial: Path) -> None:
    association = importlib.import_module(POSE2SIM)
    project = {"project_dir": str(trial), "multi_person": True, "frame_range": "all"}
    with contextlib.redirect_stderr(io.StringIO()):
        association.associate_all({"project": project, "pose": {"pose_model": "BLAZEPOSE"}})


def _located(scene: SceneOfPeople, folder: Path, k: int) -> Floats:
    """Return the persons of one time, located by the detections that belong together."""
    by_camera = [
        json.loads((folder / f"{name}_json" / f"{name}_{k:06}.json").read_bytes())["people"]
        for name in scene.frames
    ]
    if not by_camera[0]:
        return np.empty((0, len(JOINTS), 3))
    rows = np.full((len(by_camera), len(by_camera[0]), len(JOINTS), 3), np.nan)
    for camera, people in enumerate(by_camera):
        for number, person in enumerate(people):
            if person:
                rows[camera, number] = np.reshape(person["pose_keypoints_2d"], (len(JOINTS), 3))
    confidence = np.nan_to_num(rows[..., 2]).reshape(len(rows), -1)
    variances = np.where(confidence > 0, 100 / np.maximum(confidence, 1e-3) ** 2, np.inf)
    projections = np.array([camera.view.projection for camera in scene.frames.values()])
    points = locate(projections, rows[..., :2].reshape(len(rows), -1, 2), variances).points
    persons = points.reshape(-1, len(JOINTS), 3)
    return np.asarray(persons[np.isfinite(persons).all(axis=2).mean(axis=1) >= MIN_JOINTS])


def main(arguments: Sequence[str] | None = None) -> None:
    """Print counts of all kinds of scenes, by simulshot and by Pose2Sim."""
    parser = new_parser(__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="takes of each kind and rig (2)")
    parser.add_argument("--kinds", nargs="*", default=KINDS, help=", ".join(KINDS))
    parser.add_argument("--cameras", type=int, nargs="*", default=RIGS, help="numbers of cameras (3 4 5)")
    options = parser.parse_args(arguments)
    if not is_here("Pose2Sim"):
        sys.exit("Pose2Sim is not installed: make readers")
    rows = list[dict[str, Any]]()
    every: dict[str, list[Counts]] = {"simulshot": [], "Pose2Sim": []}
    for kind in options.kinds:
        scenes = [
            draw_take(kind, cameras, seed) for cameras in options.cameras for seed in range(options.seeds)
        ]
        for by, located in (("simulshot", located_by_simulshot), ("Pose2Sim", located_by_pose2sim)):
            counts = [count_people(scene, located(scene)) for scene in scenes]
            every[by] += counts
            rows.append({"kind": kind, "by": by, **total(counts).figures()})
    rows += [{"kind": "all", "by": by, **total(counts).figures()} for by, counts in every.items()]
    report: Report = {"kind": "simulated", "seeds": options.seeds, "rows": rows}
    print_report(report, lambda shown: print_rows(shown["rows"], COLUMNS), as_json=options.json)


if __name__ == "__main__":
    main()
