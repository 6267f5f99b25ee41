"""BlazePose: 33 joints of each person in an image, by TFLite models of MediaPipe (Bazarevsky et al. 2020).

Decoding after the models' cards: https://developers.google.com/mediapipe/solutions/vision/pose_landmarker.
"""

import math
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import cv2
import numpy as np

from capture_app.common.optional_packages import load_optional
from reconstruction.common.geometry import Array
from reconstruction.common.native_libraries import silenced_output
from reconstruction.methods.people.blazepose_weights import MODELS, find_weights
from reconstruction.methods.people.skeletons import SKELETONS, Skeleton

DETECTOR_PX, LANDMARK_PX, HEATMAP_PX = 224, 256, 64
"""Sides of the square images that the models take, and of the heatmaps that the second one gives."""
CELLS = {28: 2, 14: 2, 7: 6}
"""Cells a side of the detector's layers, and the anchors of a cell."""
HIP, TOP = 2, 3
"""Points of a detection: the middle of the hips, and one on the circle around the person."""
CENTRE, RIM = 33, 34
"""The same two points among the landmarks, from which the next frame's crop follows."""
CROP_SCALE = 1.25
"""Side of the crop relative to the diameter of the circle around the person."""
MIN_SCORE, MIN_PRESENCE, MIN_HEAT = 0.5, 0.5, 0.5
"""Probabilities from which on a detection counts, a crop shows a person, and a heatmap moves a landmark."""
REACH = 3
"""Cells around a landmark's own whose heat moves it."""
SAME_RADII = 0.5
"""Distance of hips, in radii of the circle around a person, within which two are the same person."""
DETECT_EVERY_S = 0.25
"""Time after which new people are searched for beside those that are followed."""
MAX_PAUSE_S = 0.5
"""Time between two frames after which those of the first are not followed into the second."""
MAX_PEOPLE = 24


class Crop(NamedTuple):
    """The turned square around a person: the middle of the hips (2,), px, and a point above the head."""

    hip: Array
    top: Array

    @property
    def radius(self) -> float:
        """Radius of the circle around the person, px."""
        return float(np.linalg.norm(self.top - self.hip))

    @property
    def image_from_crop(self) -> Array:
        """Affine map (2, 3) from pixels of the crop to those of the image."""
        across, down = (self.hip - self.top) @ [[0, -1], [1, 0]], self.hip - self.top
        axes = np.stack([across, down], axis=1) * (2 * CROP_SCALE / LANDMARK_PX)
        return np.column_stack([axes, self.hip - axes.sum(axis=1) * (LANDMARK_PX - 1) / 2])

    def is_near(self, other: "Crop") -> bool:
        """Whether two crops show the same person."""
        return float(np.linalg.norm(self.hip - other.hip)) < SAME_RADII * max(self.radius, other.radius)


class _Model:
    """One TFLite model; outputs are found by their size."""

    def __init__(self, data: bytes) -> None:
        runtime = load_optional(
            "ai_edge_litert.interpreter",
            "people",
            "finding people in images",
            hint="or bring joints of another program: --keypoints FOLDER",
        )
        self._runs: Any = runtime.Interpreter(model_content=data, num_threads=1)
        with silenced_output():  # it says which delegate it creates
            self._runs.allocate_tensors()

    def __call__(self, image: Array) -> dict[int, Array]:
        """Return the outputs for an image, side x side x 3, RGB, by their number of values."""
        self._runs.set_tensor(self._runs.get_input_details()[0]["index"], image[None].astype(np.float32))
        self._runs.invoke()
        outputs = (self._runs.get_tensor(output["index"])[0] for output in self._runs.get_output_details())
        return {output.size: output for output in outputs}


class BlazePose:
    """People of one camera's frames, followed from each frame to the next; see `Detector`."""

    skeleton: ClassVar[Skeleton] = SKELETONS["blazepose"]
    models: ClassVar[tuple[str, ...]] = MODELS
    search_every_s: float = DETECT_EVERY_S

    def __init__(self, model: str) -> None:
        self._detector, self._landmarks = map(_Model, find_weights(model))
        self._followed, self._last_s, self._searched_s = list[Crop](), -np.inf, -np.inf

    def detect(self, image: Array, at_s: float) -> tuple[Array, Array]:
        """Return the people in the next frame (BGR), at a time: pixels (n, 33, 2) and confidences (n, 33)."""
        crops = self._followed if at_s - self._last_s <= MAX_PAUSE_S else []
        self._followed, self._last_s = [], at_s
        if is_due := at_s - self._searched_s >= self.search_every_s:
            self._searched_s = at_s
        if is_due or not crops:
            # In a square of a part, people are larger.
            places = [(0, 0, *image.shape[1::-1]), *(_squares(*image.shape[1::-1]) if is_due else ())]
            crops += [crop for place in places for crop in self._search(image, *place)]
            crops = _distinct(crops)[:MAX_PEOPLE]
        people = list[Array]()
        for crop in crops:
            landmarks, presence = self._look(image, crop)
            followed = Crop(*landmarks[[CENTRE, RIM], :2])
            if presence > MIN_PRESENCE and not any(map(followed.is_near, self._followed)):
                self._followed.append(followed)
                people.append(landmarks[:CENTRE])
        boxes = np.array(people).reshape(-1, CENTRE, 3)
        return boxes[..., :2], boxes[..., 2]

    def _search(self, image: Array, left: int, top: int, width: int, height: int) -> list[Crop]:
        """Return crops around the people in a part of an image, most certain first, each several times."""
        corner, image = (left, top), image[top : top + height, left : left + width]
        side = max(height, width)
        top, left = (side - height) // 2, (side - width) // 2
        borders = top, side - height - top, left, side - width - left
        square = cv2.resize(
            cv2.copyMakeBorder(image, *borders, cv2.BORDER_CONSTANT),
            (DETECTOR_PX, DETECTOR_PX),
            interpolation=cv2.INTER_AREA,
        )
        anchors = np.concatenate([
            np.repeat((np.indices((cells, cells)).reshape(2, -1)[::-1].T + 0.5) / cells, number, axis=0)
            for cells, number in CELLS.items()
        ])  # fmt: skip
        outputs = self._detector(square[..., ::-1] / 127.5 - 1)
        scores = outputs[len(anchors)].ravel()
        points = outputs[12 * len(anchors)].reshape(-1, 6, 2)[:, [HIP, TOP]] / DETECTOR_PX + anchors[:, None]
        pixels = points * side - (left, top) - 0.5 + corner
        certain = scores > np.log(MIN_SCORE / (1 - MIN_SCORE))
        return [Crop(*pixels[place]) for place in np.argsort(-scores) if certain[place]]

    def _look(self, image: Array, crop: Crop) -> tuple[Array, float]:
        """Return landmarks (39, 3), each x and y, px, and confidence; and the probability of a person."""
        warp = crop.image_from_crop
        how = cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR
        square = cv2.warpAffine(image, warp, (LANDMARK_PX, LANDMARK_PX), flags=how)
        outputs = self._landmarks(square[..., ::-1] / 255.0)
        landmarks = outputs[195].reshape(39, 5)
        heat = outputs[39 * HEATMAP_PX**2].reshape(HEATMAP_PX, HEATMAP_PX, 39)
        # The model counts from the crop's corner, not from the middle of its first pixel.
        pixels = (_refined(landmarks[:, :2], heat) - 0.5) @ warp[:, :2].T + warp[:, 2]
        return np.column_stack([pixels, _probability(landmarks[:, 3])]), float(outputs[1].ravel()[0])


def _squares(width: int, height: int) -> list[tuple[int, int, int, int]]:
    """Return squares (left, top, side, side) along an image's longer side that overlap by half or more."""
    side, longer = min(width, height), max(width, height)
    steps = (
        np.linspace(0, longer - side, math.ceil(2 * (longer - side) / side) + 1).round().astype(int).tolist()
    )
    places = [(step, 0) if width > height else (0, step) for step in steps]
    return [(*place, side, side) for place in places] if longer > side else []


def _distinct(crops: Sequence[Crop]) -> list[Crop]:
    """Return the crops of different people, of each person the first."""
    chosen = list[Crop]()
    for crop in crops:
        if not any(map(crop.is_near, chosen)):
            chosen.append(crop)
    return chosen


def _probability(logits: Array) -> Array:
    return np.asarray(1 / (1 + np.exp(-logits)))


def _refined(points: Array, heat: Array) -> Array:
    """Return points (n, 2), px of the crop, moved to the middle of the heat, logits (64, 64, n), around each.

    As MediaPipe's `RefineLandmarksFromHeatmap` does; points outside, or without heat, stay as they are.
    """
    cells = np.floor(points * (HEATMAP_PX / LANDMARK_PX)).astype(int)
    column, row = cells.clip(0, HEATMAP_PX - 1).T
    padded = np.pad(heat, ((REACH, REACH), (REACH, REACH), (0, 0)), constant_values=-np.inf)
    around = np.lib.stride_tricks.sliding_window_view(padded, (2 * REACH + 1,) * 2, axis=(0, 1))
    near = _probability(around[row, column, np.arange(len(points))])
    steps = np.arange(-REACH, REACH + 1)
    aside = np.stack([near.sum(axis=1) @ steps, near.sum(axis=2) @ steps], axis=1)
    moved = (cells + aside / near.sum(axis=(1, 2))[:, None]) * (LANDMARK_PX / HEATMAP_PX)
    is_hot = (near.max(axis=(1, 2)) >= MIN_HEAT) & (cells == np.stack([column, row], axis=1)).all(axis=1)
    return np.where(is_hot[:, None], moved, points)
