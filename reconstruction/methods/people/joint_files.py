"""Joints in images that other programs found: OpenPose's JSON, DeepLabCut's CSV and H5, SLEAP's analysis H5.

Each file, or folder of JSON files, is one camera's, and names it. Formats after
https://cmu-perceptual-computing-lab.github.io/openpose (output), DeepLabCut's `analyze_videos` and
`sleap.io.convert`.
"""

import csv
import io
import json
import math
import pickle
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.common.optional_packages import load_optional
from capture_app.session.files.untrusted_files import check_pickle, read_input, read_text, rejecting, within
from reconstruction.common.geometry import Array
from reconstruction.methods.people.keypoints import FrameJoints, Keypoints
from reconstruction.methods.people.skeletons import SKELETONS, Skeleton
from reconstruction.scene.dataset import Dataset

HINT = "give a folder with a file or folder for each camera, named like it"
MAX_FRAMES, MAX_NUMBERS = 1_000_000, 1 << 25
"""Maximum number of frames of a camera, and of numbers of all its frames."""
_BROKEN = StopIteration, EOFError, RecursionError, pickle.UnpicklingError
_DLC_LEVELS = ("scorer", "individuals", "bodyparts", "coords")


class Labels(NamedTuple):
    """One camera's labels: pixels (frames, n, joints, 2), NaN = unseen, and confidences (frames, n, joints).

    `names` are the individuals' if they are followed; else empty.
    """

    skeleton: Skeleton
    pixels: Array
    confidence: Array
    names: tuple[str, ...] = ()


def read_keypoints(folder: Path, dataset: Dataset, cameras: Sequence[str]) -> Keypoints:
    """Read the joints of a session's cameras out of a folder.

    Raises:
        BadInputError: a file is broken, fits no camera or two, or has more frames than its camera.
    """
    files = _pair(folder, cameras)
    labels = {camera: _read(path) for camera, path in files.items()}
    skeleton = next(iter(labels.values())).skeleton
    found = dict[str, dict[int, FrameJoints]]()
    for camera, one in labels.items():
        if {*one.skeleton.joints} != {*skeleton.joints}:
            odd = sorted({*one.skeleton.joints} ^ {*skeleton.joints})[0]
            raise BadInputError(
                f"{files[camera]} and the other files differ in joints, such as {odd}", hint=HINT
            )
        instants = dataset.instants(camera)
        if len(one.pixels) > len(instants):
            raise BadInputError(
                f"{files[camera]} has {len(one.pixels)} frames, but {camera} has {len(instants)} here",
                hint="import the whole recording, or give labels of the imported part",
            )
        order = [one.skeleton.joints.index(joint) for joint in skeleton.joints]
        size, on_disk = np.array(dataset.size(camera)), np.array(dataset.size_on_disk(camera))
        pixels = (one.pixels[:, :, order] + 0.5) * (size / on_disk) - 0.5
        confidence = np.where(np.isfinite(pixels).all(axis=3), one.confidence[:, :, order].clip(0, 1), 0)
        there = np.asarray(confidence.any(axis=2))
        found[camera] = {
            instant: FrameJoints(
                pixels[k, there[k]],
                confidence[k, there[k]],
                tuple(np.array(one.names)[there[k]].tolist()) if one.names else (),
            )
            for k, instant in zip(range(len(pixels)), instants, strict=False)
        }
    paired = ", ".join(f"{camera}: {path.relative_to(folder)}" for camera, path in files.items())
    return Keypoints(skeleton, found, f"{folder} ({paired})")


def _pair(folder: Path, cameras: Sequence[str]) -> dict[str, Path]:
    """Return each camera's file of labels, or folder of JSON files: the one whose path names it.

    Of several cameras that a path names it is that of the longest name.
    """
    if not folder.is_dir():
        raise BadInputError(f"{folder} is not a folder", hint=HINT)
    files = [path for path in folder.rglob("*") if path.suffix.lower() in (".csv", ".h5", ".json")]
    found = {path.parent if path.suffix.lower() == ".json" else path for path in files}
    # DeepLabCut writes the same labels as H5 and CSV.
    sources = sorted(path for path in found if path.suffix != ".h5" or path.with_suffix(".csv") not in found)
    paired = dict[str, Path]()
    for path in sources:
        text = str(path.relative_to(folder))
        named = [one for one in cameras if re.search(rf"(?<![A-Za-z0-9]){re.escape(one)}(?!\d)", text, re.I)]
        longest = max(named, key=len, default="")
        if longest in paired:
            raise BadInputError(f"{paired[longest]} and {path} are both of the camera {longest}", hint=HINT)
        if longest:
            paired[longest] = path
    if len(paired) < 2:
        listed = ", ".join(str(path.relative_to(folder)) for path in sources[:4]) or "no CSV, H5 or JSON"
        raise BadInputError(
            f"{folder} ({listed}) has joints of {len(paired)} of the cameras {', '.join(cameras)}", hint=HINT
        )
    return paired


def _read(path: Path) -> Labels:
    reader = {".h5": _read_h5, ".csv": _read_deeplabcut}.get(path.suffix.lower(), _read_openpose)
    what = f"{path} has no joints of a kind that is known"
    with rejecting(what, ValueError, LookupError, TypeError, AttributeError, *_BROKEN):
        labels = reader(path)
        if not labels.pixels.size:
            raise ValueError("it is empty")
    return labels


def _bounded(*shape: int) -> tuple[int, ...]:
    """Return the shape of an array. Raises ValueError if the array has more than MAX_NUMBERS."""
    within(math.prod(shape), MAX_NUMBERS, "numbers")
    return shape


def _read_openpose(folder: Path) -> Labels:
    frames = dict[int, list[Array]]()
    for path in folder.glob("*.json"):
        people = [one["pose_keypoints_2d"] for one in json.loads(read_text(path))["people"]]
        frames[int(re.findall(r"\d+", path.stem)[-1])] = [np.reshape(one, (-1, 3)) for one in people if one]
    first = min(frames) if len(frames) == max(frames) else 0
    joints = {len(one) for people in frames.values() for one in people}
    if len(joints) > 1 or max(frames) >= MAX_FRAMES:
        raise ValueError("its people have different numbers of joints")
    number = sum(joints)
    values = np.zeros(_bounded(max(frames) + 1 - first, max(map(len, frames.values())), number, 3))
    for frame, people in frames.items():
        values[frame - first, : len(people)] = np.reshape(people, (-1, number, 3))
    known = {len(skeleton.joints): skeleton for skeleton in SKELETONS.values()}
    skeleton = known.get(number) or Skeleton(tuple(f"joint{k}" for k in range(1, number + 1)), ())
    return Labels(skeleton, np.where(values[..., 2:] > 0, values[..., :2], np.nan), values[..., 2])


def _read_deeplabcut(path: Path) -> Labels:
    rows = [row for row in csv.reader(io.StringIO(read_text(path))) if row]
    levels = {row[0]: row for row in rows if row[0] in _DLC_LEVELS}
    first = levels["coords"].index("x")
    heads = [levels.get(level, [""] * len(rows[0]))[first:] for level in _DLC_LEVELS[1:]]
    body = rows[len(levels) :]
    frames = [int(re.findall(r"\d+", " ".join(row[:first]))[-1]) for row in body]
    values = np.array([[value or "nan" for value in row[first:]] for row in body], float)
    return _deeplabcut_labels([*zip(*heads, strict=True)], frames, values)


def _deeplabcut_labels(columns: Sequence[Sequence[str]], frames: Sequence[int], values: Array) -> Labels:
    """Return labels of columns (individual, joint, x|y|likelihood), by the frames of the rows."""
    if max(frames) >= MAX_FRAMES:
        raise ValueError(f"it has a frame {max(frames)}")
    names, joints = (list(dict.fromkeys(column[level] for column in columns)) for level in (0, 1))
    table = np.full(_bounded(max(frames) + 1, len(names), len(joints), 3), np.nan)
    table[frames, :, :, 2] = 1.0
    for (name, joint, coordinate), column in zip(columns, values.T, strict=True):
        axis = ("x", "y", "likelihood").index(coordinate)
        table[frames, names.index(name), joints.index(joint), axis] = column
    return Labels(Skeleton(tuple(joints), ()), table[..., :2], np.nan_to_num(table[..., 2]), tuple(names))


class _Plain(pickle.Unpickler):
    """Unpickler of lists, tuples and texts; anything else could run code."""

    def find_class(self, module: str, name: str) -> Any:
        raise pickle.UnpicklingError(f"it names {module}.{name}")


def _read_h5(path: Path) -> Labels:
    h5py = load_optional("h5py", "people", "reading H5")
    data = io.BytesIO(read_input(path))
    with rejecting(f"{path} is not a readable H5 file", OSError), h5py.File(data, "r") as file:
        if "tracks" in file and "node_names" in file:
            return _sleap_labels(file)
        table = next(group["table"] for group in file.values() if "table" in group)
        _bounded(len(table), table.dtype.itemsize)
        axes = bytes(file[table.parent.name].attrs["non_index_axes"])
        check_pickle(axes)
        (_, columns), *_ = _Plain(io.BytesIO(axes)).load()
        named = [("", *column[1:])[-3:] if len(column) == 3 else tuple(column[1:]) for column in columns]
        values = np.concatenate(
            [table[name].reshape(len(table), -1) for name in table.dtype.names if name.startswith("values")],
            axis=1,
        )
        return _deeplabcut_labels(named, table["index"].tolist(), values)


def _sleap_labels(file: Any) -> Labels:
    """Return the labels of SLEAP's analysis: tracks (tracks, 2, nodes, frames)."""
    nodes = [name.decode() for name in file["node_names"][:]]
    _bounded(*file["tracks"].shape)
    tracks = file["tracks"][:].transpose(3, 0, 2, 1)
    seen = np.isfinite(tracks).all(axis=3)
    scores = file["point_scores"][:].transpose(2, 0, 1) if "point_scores" in file else np.ones(seen.shape)
    # Points that a person has corrected have no score.
    confidence = np.where(seen, np.where(np.nan_to_num(scores) > 0, scores, 1.0), 0)
    bones = tuple((int(a), int(b)) for a, b in file["edge_inds"][:]) if "edge_inds" in file else ()
    names = tuple(name.decode() for name in file["track_names"][:]) if len(file["track_names"]) else ("",)
    return Labels(Skeleton(tuple(nodes), bones), tracks, confidence, names)
