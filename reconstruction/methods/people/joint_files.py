"""Joints in images that other programs found, paired with a session's images by the frames' numbers.

Each file, or folder of JSON files, is one camera's, and names it; or a file has all cameras. A label belongs
to the image of its frame in the film or folder that was imported, wherever that image is in the session.
"""

import csv
import pickle
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from unicodedata import normalize

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.files.untrusted_files import rejecting
from reconstruction.methods.people.joint_formats import Labels, load_readers
from reconstruction.methods.people.keypoints import FrameJoints, Keypoints
from reconstruction.scene.dataset import Dataset

HINT = "give a folder with a file or folder for each camera, named like it"
SESSION = "session"
"""Value of `--label-start`: the session's own images were labelled."""
_BROKEN = (
    *(ValueError, LookupError, TypeError, AttributeError, OverflowError),
    *(StopIteration, EOFError, RecursionError, csv.Error, pickle.UnpicklingError),
)


class _Images(NamedTuple):
    """A camera's images by instant, numbered by their places in its film, or, if captured, in the session."""

    numbers: Mapping[int, int]
    total: int | None
    """Number of frames of the film, or of images; None if an earlier version imported the film."""
    of_film: bool


def read_keypoints(folder: Path, dataset: Dataset, cameras: Sequence[str], start: str = "auto") -> Keypoints:
    """Read the joints of a session's cameras out of a folder.

    `start` is the number of a film's first frame in the labels, `auto`, or `SESSION`.

    Raises:
        BadInputError: a file is broken, fits no camera or two, or its frames are not those of its camera.
    """
    if not re.fullmatch(r"auto|session|-?\d{1,9}", start):
        raise BadInputError(f"--label-start {start} is not auto, session or a number", hint="example: 1")
    filmed = {camera: dataset.labels[camera] for camera in cameras if dataset.instants(camera)}
    files, labels = _labels_in(folder, filmed)
    skeleton = next(iter(labels.values())).skeleton
    found = dict[str, dict[int, FrameJoints]]()
    for camera, one in labels.items():
        if {*one.skeleton.joints} != {*skeleton.joints}:
            odd = sorted({*one.skeleton.joints} ^ {*skeleton.joints})[0]
            raise BadInputError(
                f"{files[camera]} and the other files differ in joints, such as {odd}", hint=HINT
            )
        order = [one.skeleton.joints.index(joint) for joint in skeleton.joints]
        size, on_disk = np.array(dataset.size(camera)), np.array(dataset.size_on_disk(camera))
        pixels = (one.pixels[:, :, order] + 0.5) * (size / on_disk) - 0.5
        confidence = np.where(np.isfinite(pixels).all(axis=3), one.confidence[:, :, order].clip(0, 1), 0)
        there = np.asarray(confidence.any(axis=2))
        rows = _rows_of(str(files[camera]), one.numbers, _images_of(dataset, camera, start), start)
        found[camera] = {
            instant: FrameJoints(
                pixels[k, there[k]],
                confidence[k, there[k]],
                tuple(np.array(one.names)[there[k]].tolist()) if one.names else (),
            )
            for instant, k in rows.items()
        }
    paired = ", ".join(f"{camera}: {path.relative_to(folder)}" for camera, path in files.items())
    return Keypoints(skeleton, found, f"{folder} ({paired})")


def _images_of(dataset: Dataset, camera: str, start: str) -> _Images:
    record = dataset.session.camera(camera)
    images = {k: dataset.record(camera, k) for k in dataset.instants(camera)}
    film = {k: image.sequence for k, image in images.items() if image.sequence is not None}
    if record.facts.kind == "imported" and start != SESSION and len(film) == len(images):
        return _Images(film, record.source_frames, of_film=True)
    # Substitutes are images, too, though they count for no instant.
    own = sorted(image.instant for image in dataset.session.manifest.images if image.camera == camera)
    places = {instant: place for place, instant in enumerate(own)}
    return _Images({k: places[image.instant] for k, image in images.items()}, len(own), of_film=False)


def _rows_of(where: str, labelled: Sequence[int], images: _Images, start: str) -> dict[int, int]:
    """Return the row of the labels of each instant's image, by instant.

    Raises:
        BadInputError: the labels are of another film, or it is open of which of its frames they are.
    """
    numbers, own = np.array(labelled, object), sorted(images.numbers.values())
    low, high, end = int(numbers.min()), int(numbers.max()), images.total or own[-1] + 1
    in_order = start == SESSION or (start == "auto" and not images.of_film and len(numbers) == end)
    if in_order:
        numbers = numbers.argsort().argsort()
    else:
        # No frame has the number of all frames if they are counted from 0.
        numbers -= int(low > 0 and high == end) if start == "auto" else int(start)
    rows = {number: row for row, number in enumerate(numbers.tolist())}
    wrong = len(numbers) != end if in_order else bool(images.total) and max(rows) >= end
    if start == "auto" and not in_order:
        from_one = min(rows) == 1 and len(rows) == max(rows)
        # Labels of a cut film, counted from 0, would fit other images of it.
        cut = own != [*range(len(own))] if images.of_film else [*images.numbers] != own
        wrong |= from_one or (cut and max(rows) < (own[-1] if images.of_film else end))
    if wrong or min(rows) < 0 or len(rows) < len(numbers) or rows.keys().isdisjoint(own):
        film = f"frames {own[0]} to {own[-1]} of the {end} of its film or folder"
        raise BadInputError(
            f"{where} has {len(numbers)} frames, numbered {low} to {high}, but the session has "
            f"{film if images.of_film else f'{end} images of this camera'}",
            hint="label the whole film that was imported; or say what was labelled: --label-start N if "
            "the film's first frame has the number N, or --label-start session if all of the session's own "
            "images were labelled",
        )
    return {k: rows[number] for k, number in images.numbers.items() if number in rows}


def _labels_in(folder: Path, cameras: Mapping[str, str]) -> tuple[dict[str, Path], dict[str, Labels]]:
    """Return each camera's file, or folder of JSON files, and its labels.

    A camera's path names it, by its label or its name: of several, the longest.
    `cameras` are labels by name. A folder of JSON files
    comes before their own names.
    """
    if not folder.is_dir():
        raise BadInputError(f"{folder} is not a folder", hint=HINT)
    suffixes = {suffix for reader in load_readers().values() for suffix in reader.suffixes}
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in suffixes)
    # DeepLabCut writes the same labels as H5 and CSV.
    files = [path for path in files if path.suffix != ".h5" or path.with_suffix(".csv") not in files]
    own = dict[str, list[Path]]()
    for path in files:
        name, inside = path.relative_to(folder), path.suffix.lower() == ".json"
        camera = (_named(str(name.parent), cameras) if inside else "") or _named(str(name), cameras)
        others = own.setdefault(camera, [])
        if camera and others and (not inside or others[0].parent != path.parent):
            raise BadInputError(f"{others[0]} and {path} are both of the camera {camera}", hint=HINT)
        others.append(path)
    of_all = own.pop("", [])
    labels = dict[str, Labels]()
    for camera, of in own.items():
        if not isinstance(one := _read(of), Labels):
            raise BadInputError(f"{of[0]} has no joints of one camera in a format that is known", hint=HINT)
        labels[camera] = one
    paths = {camera: of[0].parent if len(of) > 1 else of[0] for camera, of in own.items()}
    for path in of_all if len(own) < 2 else ():
        if (each := _read([path])) is None or isinstance(each, Labels):
            continue
        if len(each) != len(cameras):
            raise BadInputError(f"{path} has {len(each)} cameras, not {', '.join(cameras)}", hint=HINT)
        labels = dict(zip(sorted(cameras), each, strict=True))
        paths = dict.fromkeys(labels, path)
    if len(paths) < 2:
        listed = ", ".join(str(path.relative_to(folder)) for path in files[:4]) or "no file of a known kind"
        raise BadInputError(
            f"{folder} ({listed}) has joints of {len(paths)} of the cameras {', '.join(cameras)}", hint=HINT
        )
    return paths, labels


def _named(text: str, cameras: Mapping[str, str]) -> str:
    names = {name: name for name in cameras} | {label: name for name, label in cameras.items()}
    whole = {one: rf"(?<![A-Za-z0-9]){re.escape(one)}(?!\d)" for one in names}
    found = [one for one in names if re.search(whole[one], normalize("NFC", text), re.IGNORECASE)]
    return names[max(found, key=len)] if found else ""


def _read(paths: Sequence[Path]) -> Labels | Sequence[Labels] | None:
    """Return what the first reader that knows the files finds: one camera's labels, or all cameras'."""
    with rejecting(f"{paths[0]} is broken", *_BROKEN):
        for reader in load_readers().values():
            if paths[0].suffix.lower() in reader.suffixes and (labels := reader.read(paths)) is not None:
                for one in [labels] if isinstance(labels, Labels) else labels:
                    _check(one)
                return labels
    return None


def _check(labels: Labels) -> None:
    """Raise ValueError for labels without joints, or with other joints or bones than their skeleton's."""
    joints, joined = len(labels.skeleton.joints), {k for bone in labels.skeleton.bones for k in bone}
    if not labels.pixels.size:
        raise ValueError("it has no labels")
    if joints != labels.pixels.shape[2] or not joined <= {*range(joints)}:
        raise ValueError(f"its people or its bones have joints other than the {joints} that it names")
