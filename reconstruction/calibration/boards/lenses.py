"""Each camera's lens from pictures of a board (Zhang 2000), which may be recordings of their own."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from capture_app.board.detector import Board, BoardDetector, Corners
from capture_app.errors import BadInputError
from capture_app.text import count
from reconstruction.common.geometry import Array
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import evenly_spread

MIN_BOARDS = 4
MAX_BOARDS = 40

Lens = tuple[Array, Array]
"""The camera matrix 3x3 in px and OpenCV's distortion (5,)."""


def calibrate_lens(name: str, size: tuple[int, int], board: Board, seen: Sequence[Corners]) -> Lens:
    """The lens of a camera of this size (px) that saw the board so often.

    Raises:
        BadInputError: it saw the board too rarely.
    """
    if len(seen) < MIN_BOARDS:
        raise BadInputError(
            f"{name} shows the board in {count(len(seen), 'image')}; {MIN_BOARDS} are needed",
            hint="record the board from more places; check --board, --square-mm and --dictionary",
        )
    seen = evenly_spread(list(seen), MAX_BOARDS)
    points = [board.places[sorted(corners)] for corners in seen]
    pixels = [np.array([corners[i] for i in sorted(corners)], np.float32) for corners in seen]
    # Few boards, or boards at one angle, do not determine the higher terms of distortion.
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    _, matrix, distortion, _, _ = cv2.calibrateCamera(
        points, pixels, size, np.eye(3), np.zeros(5), flags=flags
    )
    return np.asarray(matrix), np.asarray(distortion).ravel()[:5]


def lenses_of_recordings(dataset: Dataset, board: Board, paths: Sequence[Path]) -> dict[str, Lens]:
    """The lenses of a session's cameras from recordings in which some of them see the board, each for itself.

    Raises:
        BadInputError: a recording is of none of these cameras, of another size, or shows too little.
    """
    seen: dict[str, list[Corners]] = {}
    for path in paths:
        recording = Dataset.open(path)
        shared = [name for name in recording.cameras if name in dataset.cameras]
        if not shared:
            raise BadInputError(
                f"{recording.name} was taken by other cameras ({', '.join(recording.cameras)})",
                hint=f"{dataset.name} has {', '.join(dataset.cameras)}",
            )
        for name in shared:
            if recording.size(name) != dataset.size(name):
                sizes = ["x".join(map(str, of.size(name))) for of in (recording, dataset)]
                raise BadInputError(
                    f"{name} has pictures of {sizes[0]} in {recording.name}, of {sizes[1]} in {dataset.name}",
                    hint="record the board in the mode that is used later: another may show another part",
                )
            seen.setdefault(name, []).extend(_sightings(recording, name, board))
    return {name: calibrate_lens(name, dataset.size(name), board, found) for name, found in seen.items()}


def _sightings(recording: Dataset, name: str, board: Board) -> list[Corners]:
    detector = BoardDetector(board)
    found = (detector.detect(recording.grey(name, instant)) for instant in recording.instants(name))
    return [corners for corners in found if corners]
