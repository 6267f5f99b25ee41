"""Detection of a panel in an image by the ArUco markers of its frame."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.common.grouping import grouped
from capture_app.companions.panel.pattern import (
    DICTIONARY,
    MARKER_SIZE,
    PANEL_OF_MARKER,
    Panel,
    corners_of_marker,
)

Floats = NDArray[np.float64]

MIN_MARKERS = 3
"""Markers, of a panel's four, that must be visible; one may be occluded."""
MAX_ERROR = 0.15
"""Maximum mean error of marker corners against a flat frame, in pitches: a quarter of a lamp. A lens or a
bent print causes it."""
BENDS, SHRINKS = np.linspace(-0.12, 0.2, 33), np.linspace(-0.08, 0.08, 17)
"""Search ranges: radial distortion at half the image width, from pincushion to wide-angle barrel, and the
fraction by which blur shrinks markers."""
_MIN_PITCH_PX = 5.0
"""Minimum pixels per pitch; below it, the light of neighbouring lamps overlaps."""
_MIN_SIDE_PX = _MIN_PITCH_PX * min(min(panel.width, panel.height) for panel in PANEL_OF_MARKER.values())
"""A narrower image shows no readable panel. Its noise looks like many markers, so that a search in 64x96 took
three times as long as in 1280x960."""
_LARGE_PX = 1600
"""Wider images are also searched at half size, because markers may be too large to detect."""


@dataclass(frozen=True, slots=True)
class FoundPanel:
    """Panel detected in an image; `matrix` (3, 3) is the homography from panel coordinates to pixels.

    `bend` is the lens's first radial distortion coefficient, with radii from `middle` (x, y) in half image
    widths.
    """

    panel: Panel
    matrix: Floats
    bend: float
    middle: tuple[float, float]
    markers: int
    error: float = 0.0
    """Mean distance of marker corners from their predicted positions, in pitches."""

    def pixels(self, places: Floats) -> Floats:
        """Return the pixels (n, 2) of points (n, 2) on the panel."""
        seen = np.column_stack([places, np.ones(len(places))]) @ self.matrix.T
        return _bend(np.asarray(seen[:, :2] / seen[:, 2:]), self.bend, self.middle)

    @property
    def pitch_px(self) -> float:
        """Return the smaller pixel distance of neighbouring lamps, across or down, at the panel's centre."""
        x, y = self.panel.width / 2, self.panel.height / 2
        at, right, down = self.pixels(np.array([[x, y], [x + 1, y], [x, y + 1]]))
        return float(min(np.linalg.norm(right - at), np.linalg.norm(down - at)))


class PanelNotFoundError(Exception):
    """No panel is visible in an image, or its time cannot be read; the message gives the reason."""


def panels_seen(grey: NDArray[np.uint8]) -> list[str]:
    """Return the names of all panels with MIN_MARKERS markers in a grey image, in a quick look.

    A panel of a name that is seen twice is named twice.
    """
    names: list[str] = []
    for seen, scale in _looks(grey) if min(grey.shape) >= _MIN_SIDE_PX else ():
        markers = Counter(number for number, _ in _markers(_detector(), seen, scale))
        names = [
            name
            for name, numbers in _by_panel(markers).items()
            for times in range(1, max(markers.values()) + 1)
            if sum(markers[number] >= times for number in numbers) >= MIN_MARKERS
        ]
        # An image without any marker is not searched further: most of a video's are such.
        if names or not _by_panel(markers):
            break
    return sorted(names)


def _by_panel(numbers: Iterable[int]) -> dict[str, list[int]]:
    """Return the marker numbers of each panel, by its name."""
    return grouped((PANEL_OF_MARKER[number].name, number) for number in numbers if number in PANEL_OF_MARKER)


def find_panel(grey: NDArray[np.uint8]) -> FoundPanel:
    """Return the panel with the most visible markers in a grey image (uint8). Raises PanelNotFoundError."""
    detector = _detector()
    best: dict[int, Floats] = {}
    for seen, scale in _looks(grey):
        best = max(best, _of_one_panel(dict(_markers(detector, seen, scale))), key=len)
        if len(best) == 4:
            break
    if len(best) < MIN_MARKERS:
        raise PanelNotFoundError(
            f"{len(best)} markers of a panel were found; {MIN_MARKERS} are needed"
            if best
            else "no marker of a panel was found"
        )
    return _place(best, ((grey.shape[1] - 1) / 2, (grey.shape[0] - 1) / 2))


def _looks(grey: NDArray[np.uint8]) -> Iterator[tuple[NDArray[Any], float]]:
    """Yield the image variants to search, each with its scale relative to the original."""
    yield grey, 1.0
    # In dark images from short exposures, unlit markers have little contrast.
    yield cv2.createCLAHE(4.0, (8, 8)).apply(grey), 1.0
    scale, method = (0.5, cv2.INTER_AREA) if grey.shape[1] > _LARGE_PX else (2.0, cv2.INTER_CUBIC)
    yield cv2.resize(grey, None, fx=scale, fy=scale, interpolation=method), scale


def _detector() -> "cv2.aruco.ArucoDetector":
    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{DICTIONARY}"))
    options = cv2.aruco.DetectorParameters()
    options.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    options.minMarkerPerimeterRate = 0.02
    return cv2.aruco.ArucoDetector(words, options)


def _markers(
    detector: "cv2.aruco.ArucoDetector", grey: NDArray[Any], scale: float
) -> list[tuple[int, Floats]]:
    """Return the number and the corners (4, 2) of each marker in an image."""
    corners, numbers, _ = detector.detectMarkers(grey)
    if numbers is None:
        return []
    # Integer coordinates are pixel centres.
    places = [(np.asarray(each, float).reshape(4, 2) + 0.5) / scale - 0.5 for each in corners]
    return list(zip(np.ravel(numbers).tolist(), places, strict=True))


def _of_one_panel(markers: dict[int, Floats]) -> dict[int, Floats]:
    """Return the markers of the panel that has the most visible ones."""
    panels = [{n: markers[n] for n in numbers} for numbers in _by_panel(markers).values()]
    return max(panels, key=len, default={})


def _place(markers: dict[int, Floats], middle: tuple[float, float]) -> FoundPanel:
    panel = PANEL_OF_MARKER[next(iter(markers))]
    at = {number: np.array(corners_of_marker(left, top)) for number, left, top in panel.markers}
    corners = np.stack([at[number] for number in markers])
    pixels = np.concatenate(list(markers.values()))
    bend, shrink = 0.0, 0.0
    best = _fit(panel, corners, pixels, bend, shrink, middle)
    # Blur rounds off marker corners, which resembles lens distortion; both are estimated in turn.
    for _ in range(3):
        if len(markers) == 4:
            # Fewer markers cannot separate distortion from perspective.
            fits = [_fit(panel, corners, pixels, float(each), shrink, middle) for each in BENDS]
            best = min(fits, key=lambda fit: fit.error)
            bend = best.bend
        tried = [(_fit(panel, corners, pixels, bend, float(each), middle), float(each)) for each in SHRINKS]
        best, shrink = min(tried, key=lambda fit: fit[0].error)
    if best.error > MAX_ERROR:
        raise PanelNotFoundError(
            f"the markers of the panel are not on a flat frame ({best.error:.2f} pitches off)"
        )
    if best.pitch_px < _MIN_PITCH_PX:
        raise PanelNotFoundError(
            f"the panel is too small: its lamps are {best.pitch_px:.1f} pixels apart, "
            f"{_MIN_PITCH_PX:g} are needed"
        )
    return best


def _fit(
    panel: Panel, corners: Floats, pixels: Floats, bend: float, shrink: float, middle: tuple[float, float]
) -> FoundPanel:
    """Fit the panel to marker corners (n, 4, 2) shrunk by a fraction and seen through a distorting lens."""
    centres = corners.mean(axis=1, keepdims=True)
    places = (centres + (1 - shrink) * (corners - centres)).reshape(-1, 2)
    matrix, _ = cv2.findHomography(places, _unbend(pixels, bend, middle))
    if matrix is None:
        raise PanelNotFoundError("the markers of the panel are on one line")
    placed = FoundPanel(panel, np.asarray(matrix, float), bend, middle, len(corners))
    side = np.linalg.norm(np.diff(pixels.reshape(-1, 4, 2), axis=1), axis=2).mean() / MARKER_SIZE
    return replace(placed, error=float(np.linalg.norm(placed.pixels(places) - pixels, axis=1).mean() / side))


def _unbend(pixels: Floats, bend: float, middle: tuple[float, float]) -> Floats:
    """Return pixels (n, 2) with the lens distortion removed."""
    from_centre = (pixels - middle) / middle[0]
    return np.asarray(
        middle + middle[0] * from_centre * (1 + bend * (from_centre**2).sum(axis=1, keepdims=True))
    )


def _bend(pixels: Floats, bend: float, middle: tuple[float, float]) -> Floats:
    """Apply the distortion that `_unbend` removes, to a small part of a pixel for ordinary lenses."""
    straight = from_centre = (pixels - middle) / middle[0]
    for _ in range(8 if bend else 0):
        from_centre = straight / (1 + bend * (from_centre**2).sum(axis=1, keepdims=True))
    return np.asarray(middle + middle[0] * from_centre)
