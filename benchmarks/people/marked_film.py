"""People in a public film whose joints people have marked, from OpenPose's detections. Real footage.

FOLDER is `data/shelf` of the repository `4d_association`: Belagiannis' film of four people by five cameras
(301 frames; two to three people are marked in a frame), and OpenPose's joints in it. Who is who, joints
against the marks, and how many are within the error: of precision alone, with the bias that is stored, and
with a bias that is fitted to one half of the film in the other half.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import repeat
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.people.figure import Floats
from benchmarks.people.scores import Scores, score
from benchmarks.report import Columns, Report, new_parser, print_report, print_rows
from capture_app.common.errors import BadInputError
from reconstruction.common.geometry import View
from reconstruction.methods.people.detector_bias import detector_bias
from reconstruction.methods.people.joint_positions import Person
from reconstruction.methods.people.keypoints import FrameJoints
from reconstruction.methods.people.people_run import CameraFrames, PeopleFinder
from reconstruction.methods.people.skeletons import SKELETONS

SIZE, FRAMES_PER_S = (1032, 776), 25
SKELETON = SKELETONS["body_25"]
JOINTS = SKELETON.joints
MARKED = (
    "RAnkle RKnee RHip LHip LKnee LAnkle RWrist RElbow RShoulder LShoulder LElbow LWrist".split()  # noqa: SIM905
)
"""The marked joints that OpenPose has, too, in the file's order, of whose 15 they are the first."""
MARKS = 15
HIPS = ("RHip", "LHip")
"""Marked elsewhere than OpenPose finds them."""
PAIRS_OF_JOINTS = (
    (1, 9, 10, 8, 8, 12, 13, 1, 2, 3, 2, 1, 5, 6, 5, 1, 0, 0, 15, 16, 14, 19, 14, 11, 22, 11),
    (8, 10, 11, 9, 12, 13, 14, 2, 3, 4, 17, 5, 6, 7, 18, 0, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24),
)
"""The pairs of joints that OpenPose scores, in the file's order."""
FEWEST = 5
"""Joints of a detection."""
WITHIN, ROUNDS = 0.95, 9
"""Fraction that a fitted bias has within the error, and the rounds of bisection."""
BIASES = (0.0, 0.005, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1)
"""Biases of which errors are computed."""
COLUMNS: Columns = {
    "error": ("error", ""),
    "joints": ("joints", ""),
    "true": ("marked", "d"),
    "found": ("individuals", "d"),
    "changes": ("changes of number, 1/1000", ".2f"),
    "missing": ("missing joints", ".2%"),
    "median": ("median, mm", ".0f"),
    "most": ("90 %, mm", ".0f"),
    "within": ("within the error", ".1%"),
}


class Candidates(NamedTuple):
    """OpenPose's joints of one frame, each (3, n) in parts of the image, and the scores of pairs of them."""

    joints: Sequence[Floats]
    scores: Sequence[Floats]


def read_candidates(path: Path) -> Iterator[Candidates]:
    """Yield the frames of a camera's file."""
    words = iter(path.read_text("utf-8").split())

    def numbers(*shape: int) -> Floats:
        return np.array([float(next(words)) for _ in range(int(np.prod(shape)))]).reshape(shape)

    next(words)
    for _ in range(int(next(words))):
        joints = [numbers(3, int(next(words))) for _ in JOINTS]
        yield Candidates(
            joints,
            [numbers(joints[a].shape[1], joints[b].shape[1]) for a, b in zip(*PAIRS_OF_JOINTS, strict=True)],
        )


def detections(frame: Candidates) -> FrameJoints:
    """Join a frame's joints into detections, the best pairs first."""
    pairs = sorted(
        (
            (float(scores[i, k]), (a, i), (b, k))
            for a, b, scores in zip(*PAIRS_OF_JOINTS, frame.scores, strict=True)
            for i, k in np.argwhere(scores > 0).tolist()
        ),
        reverse=True,
    )
    owner = dict[tuple[int, int], dict[int, int]]()
    for _, *ends in pairs:
        bodies = [owner.get(end, dict([end])) for end in ends]
        if bodies[0] is bodies[1] or bodies[0].keys() & bodies[1].keys():
            continue
        bodies[0].update(bodies[1])
        owner.update(zip(bodies[0].items(), repeat(bodies[0])))
    people = {id(body): body for body in owner.values() if len(body) >= FEWEST}.values()
    seen = np.zeros((len(people), len(JOINTS), 3))
    for row, body in enumerate(people):
        for joint, number in body.items():
            seen[row, joint] = frame.joints[joint][:, number] * (SIZE[0] - 1, SIZE[1] - 1, 1)
    return FrameJoints(seen[..., :2], seen[..., 2])


def read_cameras(folder: Path) -> dict[str, CameraFrames]:
    """Return the frames of all cameras with their detections."""
    cameras = dict[str, CameraFrames]()
    for name, of in json.loads((folder / "calibration.json").read_text("utf-8")).items():
        pose = np.reshape(of["RT"], (3, 4))
        view = View(*SIZE, np.reshape(of["K"], (3, 3)), np.zeros(5), pose[:, :3], pose[:, 3])
        joints = dict(enumerate(map(detections, read_candidates(folder / "detection" / f"{name}.txt"))))
        cameras[name] = CameraFrames(view, np.arange(len(joints)) / FRAMES_PER_S, 0.0, 0.0, joints)
    return cameras


def read_marks(path: Path) -> Floats:
    """Return the marked joints (people, times, joints, 3), m; NaN = not marked."""
    words = iter(path.read_text("utf-8").split()[1:])
    frames = int(next(words))
    people = dict[int, Floats]()
    places = [JOINTS.index(name) for name in MARKED]
    for frame in range(frames):
        for _ in range(int(next(words))):
            person = int(next(words))
            joints = np.array([float(next(words)) for _ in range(4 * MARKS)]).reshape(4, MARKS)[
                :, : len(MARKED)
            ]
            own = people.setdefault(person, np.full((frames, len(JOINTS), 3), np.nan))
            own[frame, places] = np.where(joints[3] > 0, joints[:3], np.nan).T
    return np.stack([*people.values()])


class Film:
    """The film's people, matched once, and its marks."""

    def __init__(self, folder: Path) -> None:
        self.marks = read_marks(folder / "gt.txt")
        finder = PeopleFinder(read_cameras(folder), SKELETON, 1 / FRAMES_PER_S)
        times_s = np.arange(self.marks.shape[1]) / FRAMES_PER_S
        located = list[Sequence[Person]]()
        for bias in BIASES:
            finder.locator.bias = np.full(len(JOINTS), bias)
            located.append(finder.at(times_s).people)
        self._people = located[0]
        self._squared = [np.stack([person.error for person in of]) ** 2 for of in zip(*located, strict=True)]

    def people(self, bias: Floats) -> Sequence[Person]:
        """Return the people in time, their errors with a bias (joints,)."""
        after = np.clip(np.searchsorted(BIASES, bias), 1, len(BIASES) - 1)
        low, high = (np.square(BIASES)[k] for k in (after - 1, after))
        part, every = (bias**2 - low) / (high - low), np.arange(len(JOINTS))
        return [
            # An error's square grows nearly in proportion to that of the bias.
            person._replace(
                error=np.sqrt((1 - part) * of[after - 1, :, every].T + part * of[after, :, every].T)
            )
            for person, of in zip(self._people, self._squared, strict=True)
        ]

    def scores(self, bias: Floats, names: Sequence[str], frames: slice = slice(None)) -> Scores:
        """Return the scores of some joints in some of the frames."""
        of = np.isin(JOINTS, names)[None, None, :, None]
        shown = np.full_like(self.marks, np.nan)
        shown[:, frames] = self.marks[:, frames]
        truth = np.where(of, shown, np.nan)
        return score(truth, np.asarray(np.isfinite(truth).all(axis=3)), self.people(bias))

    def fit(self, frames: slice = slice(None)) -> Floats:
        """Return the least bias (joints,) with which WITHIN of each kind of joint are within the error."""
        fitted = np.full(len(JOINTS), np.nan)
        for kind in dict.fromkeys(name[1:] for name in MARKED):
            names = [f"R{kind}", f"L{kind}"]
            low, high = BIASES[0], BIASES[-1]
            for _ in range(ROUNDS):
                middle = (low + high) / 2
                is_enough = (
                    self.scores(np.full(len(JOINTS), middle), names, frames).figures()["within"] >= WITHIN
                )
                low, high = (low, middle) if is_enough else (middle, high)
            fitted[np.isin(JOINTS, names)] = high
        return np.asarray(np.where(np.isnan(fitted), np.nanmax(fitted), fitted))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the scores of the film."""
    parser = new_parser(__doc__)
    parser.add_argument("folder", type=Path, help="data/shelf of 4d_association")
    options = parser.parse_args(arguments)
    if not (options.folder / "gt.txt").is_file():
        raise BadInputError(
            f"{options.folder} has no gt.txt", hint="clone zhangyux15/4d_association: data/shelf"
        )
    film = Film(options.folder)
    half = film.marks.shape[1] // 2
    first, second = slice(half), slice(half, None)
    stored, _ = detector_bias(SKELETON)
    whole = film.fit()
    without = np.zeros(len(JOINTS))
    limbs = [name for name in MARKED if name not in HIPS]
    judged: Mapping[str, tuple[Floats, slice]] = {
        "precision alone": (without, slice(None)),
        "with the stored bias": (without if stored is None else stored, slice(None)),
        "bias of the first half, in the second": (film.fit(first), second),
        "bias of the second half, in the first": (film.fit(second), first),
    }
    rows = [
        {"error": error, "joints": words, **film.scores(bias, names, frames).figures()}
        for error, (bias, frames) in judged.items()
        for words, names in (("without hips", limbs), ("all", MARKED))
    ]
    report: Report = {
        "kind": "real footage",
        "rows": rows,
        "fitted": {name: round(float(whole[JOINTS.index(name)]), 4) for name in MARKED},
    }

    def print_tables(of: Report) -> None:
        print_rows(of["rows"], COLUMNS)
        print_rows([of["fitted"]], {name: (name, ".4f") for name in MARKED})

    print_report(report, print_tables, as_json=options.json)


if __name__ == "__main__":
    main()
