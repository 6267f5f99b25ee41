"""Coverage of a rig's images by a calibration board held in front of the cameras, and what is missing.

A view counts only if the board's pose differs from every view counted before, so a board held still counts
once.
"""

from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Any

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from capture_app.board.boards import MIN_CORNERS
from capture_app.board.detector import Board, BoardDetector, Corners

MIN_VIEWS = 10
"""Minimum number of different views for calibrating a camera's lens, as OpenCV recommends."""
MIN_SHARED = 6
"""Minimum number of different views that two neighbouring cameras share."""
GRID = (8, 6)
"""Cells across and down; `covered` is the fraction of cells with a corner in them."""
MIN_COVERED = 0.6
TILT_DEG = 15.0
"""Minimum tilt for a view to count as tilted, degrees."""
MIN_TILTED = 2
"""Minimum number of views tilted left or right, and of views tilted up or down."""
NEW_PLACE = 0.06
"""A view is new if its corners moved by this fraction of the image diagonal ..."""
NEW_TILT_DEG = 8.0
"""... or if its tilt changed by this angle, degrees."""
NAMES = (
    ("upper left", "top", "upper right"),
    ("left", "middle", "right"),
    ("lower left", "bottom", "lower right"),
)
MOMENT_NS = 300_000_000
"""Maximum time between previews of one moment; the board is moved by hand."""


class CameraCoverage(Struct, frozen=True, kw_only=True):
    """The board's coverage of one camera's images."""

    views: int
    covered: float
    """Fraction of the image with corners."""
    empty: tuple[str, ...]
    """Names of the ninths of the image with hardly any corners."""
    tilted_across: int
    """Number of views tilted left or right; `tilted_along` counts the views tilted up or down."""
    tilted_along: int


class SharedViews(Struct, frozen=True, kw_only=True):
    """Number of different views that two cameras share."""

    cameras: tuple[str, str]
    views: int


class BoardCoverage(Struct, frozen=True, kw_only=True):
    """Coverage of a rig's images so far; `missing` lists what to do next, most urgent first."""

    cameras: dict[str, CameraCoverage]
    shared: tuple[SharedViews, ...]
    missing: tuple[str, ...]

    @property
    def enough(self) -> bool:
        """Whether the coverage suffices for a calibration: nothing is missing."""
        return not self.missing


View = tuple[NDArray[Any], NDArray[Any]]
"""A board's pose in an image: its four outer corners as fractions of the diagonal, and its normal."""


def _are_similar(view: View, other: View) -> bool:
    moved = float(np.linalg.norm(view[0] - other[0], axis=1).mean())
    turned = float(np.degrees(np.arccos(np.clip(view[1] @ other[1], -1, 1))))
    return moved < NEW_PLACE and turned < NEW_TILT_DEG


class _CameraCount:
    """Views of the board in one camera so far: distinct poses, and the corners in each part of the image."""

    def __init__(self) -> None:
        self.views: list[View] = []
        self.corners = np.zeros((GRID[1], GRID[0]), int)
        self.ninths = np.zeros((3, 3), int)

    def add(self, view: View, at: NDArray[Any]) -> bool:
        """Add a view if it is new, and return whether it is; `at`: its corners (n, 2), 0..1 of the image."""
        inside = at.clip(0, 1 - 1e-9)
        for counted in (self.corners, self.ninths):
            columns, rows = np.floor(inside * counted.shape[::-1]).astype(int).T
            np.add.at(counted, (rows, columns), 1)
        if any(_are_similar(view, known) for known in self.views):
            return False
        self.views.append(view)
        return True

    def coverage(self) -> CameraCoverage:
        normals = np.array([normal for _, normal in self.views]).reshape(-1, 3)
        tilted = np.degrees(np.arcsin(np.abs(normals[:, :2]).clip(0, 1))) > TILT_DEG
        across, along = tilted.sum(axis=0).tolist()
        return CameraCoverage(
            views=len(self.views),
            covered=float((self.corners > 0).mean()),
            empty=tuple(np.array(NAMES)[self.ninths < MIN_CORNERS].tolist()),
            tilted_across=across,
            tilted_along=along,
        )


class CoverageCount:
    """Counter of how well each camera has seen a board; images are added one moment at a time."""

    def __init__(self, board: Board, sizes: Mapping[str, tuple[int, int]]) -> None:
        """Start without views; `sizes` are width and height of each camera's images, px."""
        self._places = np.asarray(board.places, np.float64)[:, :2]
        ends = self._places.min(0), self._places.max(0)
        self._outline = np.array([[ends[i][0], ends[j][1]] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))])
        self._sizes = dict(sizes)
        self._cameras = {name: _CameraCount() for name in sizes}
        self._shared = dict.fromkeys(combinations(sizes, 2), 0)

    def add(self, moment: Mapping[str, Corners], earlier: Mapping[str, Corners] | None = None) -> None:
        """Count what the cameras saw at one moment; cameras that did not see the board may be omitted.

        `earlier`: other cameras' corners of the same moment that were counted before.
        """
        many = {name: corners for name, corners in moment.items() if len(corners) >= MIN_CORNERS}
        new = {name for name, corners in many.items() if self._add_view(name, corners)}
        seen = {**(earlier or {}), **moment}
        for pair in self._shared:
            a, b = (seen.get(name, {}) for name in pair)
            if len(a.keys() & b.keys()) >= MIN_CORNERS and new & set(pair):
                self._shared[pair] += 1

    def coverage(self) -> BoardCoverage:
        """Return the coverage of all images added so far."""
        cameras = {name: counted.coverage() for name, counted in self._cameras.items()}
        return BoardCoverage(
            cameras=cameras,
            shared=tuple(SharedViews(cameras=pair, views=n) for pair, n in self._shared.items() if n),
            missing=(*_unjoined(cameras, self._shared), *_missing_views(cameras)),
        )

    def _add_view(self, name: str, corners: Corners) -> bool:
        ids = sorted(corners)
        pixels = np.array([corners[number] for number in ids], np.float64)
        matrix, _ = cv2.findHomography(self._places[ids], pixels)
        if matrix is None:
            return False
        size = self._sizes[name]
        outline = cv2.perspectiveTransform(self._outline[None], matrix)[0] / np.hypot(*size)
        return self._cameras[name].add((outline, _normal(matrix, *size)), (pixels + 0.5) / size)


def _normal(matrix: NDArray[Any], width: int, height: int) -> NDArray[Any]:
    """Return the board's normal (3,) in the camera's frame, assuming a lens with a typical field of view."""
    focal = float(max(width, height))
    lens = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    normal = np.cross(*(np.linalg.inv(lens) @ matrix)[:, :2].T)
    return np.asarray(normal / max(float(np.linalg.norm(normal)), 1e-12))


def _missing_views(cameras: Mapping[str, CameraCoverage]) -> Iterator[str]:
    for name, seen in sorted(cameras.items(), key=lambda item: (item[1].views, item[0])):
        if not seen.views:
            yield f"{name} has not seen the board yet: hold it nearer, with all of it in the picture"
            continue
        if seen.covered < MIN_COVERED and seen.empty:
            yield f"move the board to the {' and the '.join(seen.empty[:2])} of {name}"
        if seen.tilted_across < MIN_TILTED:
            yield f"tilt the board more to the left and right for {name}"
        if seen.tilted_along < MIN_TILTED:
            yield f"tilt the board more up and down for {name}"
        if seen.views < MIN_VIEWS:
            yield f"{MIN_VIEWS - seen.views} more different views for {name}"


def _unjoined(cameras: Mapping[str, CameraCoverage], shared: Mapping[tuple[str, str], int]) -> Iterator[str]:
    """Yield instructions that connect the rig's groups of cameras, by the pairs with most shared views."""
    groups = [{name} for name in cameras]
    for (a, b), views in sorted(shared.items(), key=lambda item: -item[1]):
        first, second = (next(group for group in groups if name in group) for name in (a, b))
        if first is second:
            continue
        groups.remove(second)
        first |= second
        if views < MIN_SHARED:
            yield f"hold the board where {a} and {b} both see it ({views} of {MIN_SHARED} views)"


def coverage_table(coverage: BoardCoverage) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of a table: each camera, and the cameras that it shares views with."""

    def others(name: str) -> str:
        shared = (camera for camera in coverage.shared if name in camera.cameras)
        return ", ".join(
            f"{camera.cameras[1 - camera.cameras.index(name)]} {camera.views}" for camera in shared
        )

    return ("camera", "views", "covered", "tilted ↔", "tilted ↕", "shared with"), [
        (
            name,
            str(seen.views),
            f"{100 * seen.covered:.0f} %",
            str(seen.tilted_across),
            str(seen.tilted_along),
            others(name) or "–",
        )
        for name, seen in coverage.cameras.items()
    ]


class PreviewCount:
    """Coverage of a rig from its previews, at any preview size."""

    def __init__(self, board: Board, sizes: Mapping[str, tuple[int, int]]) -> None:
        """Start without views; `sizes` are width and height of each camera's full images, px."""
        self._sizes = dict(sizes)
        self._count = CoverageCount(board, sizes)
        self._detectors = {name: BoardDetector(board) for name in sizes}
        self._latest: dict[str, tuple[int, Corners]] = {}

    def add(self, camera: str, leader_ns: int | None, preview: NDArray[np.uint8] | None) -> BoardCoverage:
        """Count one preview (BGR; None if it cannot be decoded) and return the coverage.

        `leader_ns` is its time, None if unknown.
        """
        if preview is not None and camera in self._sizes:
            grey = np.asarray(cv2.cvtColor(preview, cv2.COLOR_BGR2GRAY), np.uint8)
            scale = np.array(self._sizes[camera]) / grey.shape[::-1]
            corners = {
                number: (at + 0.5) * scale - 0.5
                for number, at in self._detectors[camera].detect(grey).items()
            }
            others = {}
            if leader_ns is not None:
                self._latest[camera] = leader_ns, corners
                others = {
                    name: seen
                    for name, (at_ns, seen) in self._latest.items()
                    if abs(at_ns - leader_ns) < MOMENT_NS
                }
            self._count.add({camera: corners}, others)
        return self._count.coverage()
