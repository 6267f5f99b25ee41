"""BlazePose: 33 joints of each person in an image, by TFLite models of MediaPipe (Bazarevsky et al. 2020).

Decoding after the models' cards: https://developers.google.com/mediapipe/solutions/vision/pose_landmarker.
"""

from typing import Any, ClassVar, NamedTuple

import cv2
import numpy as np

from capture_app.common.optional_packages import load_optional
from reconstruction.common.geometry import Array
from reconstruction.methods.people.blazepose_weights import MODELS, find_weights
from reconstruction.methods.people.skeletons import SKELETONS, Skeleton

DETECTOR_PX, LANDMARK_PX = 224, 256
"""Sides of the square images that the models take."""
STRIDES = (8, 16, 32, 32, 32)
"""Pixels between the anchors of the detector's layers, each with two anchors a place."""
HIP, TOP = 2, 3
"""Points of a detection: the middle of the hips, and one on the circle around the person."""
CENTRE, RIM = 33, 34
"""The same two points among the landmarks, from which the next frame's crop follows."""
CROP_SCALE = 1.25
"""Side of the crop relative to the diameter of the circle around the person."""
MIN_SCORE, MIN_PRESENCE = 0.5, 0.5
"""Probabilities from which on a detection counts, and a crop shows a person."""
SAME_RADII = 0.5
"""Distance of hips, in radii of the circle around a person, within which two are the same person."""
DETECT_EVERY = 8
"""Frames after which new people are searched for beside those that are followed."""
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
        return np.column_stack([axes, self.hip - axes.sum(axis=1) * LANDMARK_PX / 2])

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
        self._runs.allocate_tensors()
        self._input = self._runs.get_input_details()[0]["index"]
        self._outputs = [output["index"] for output in self._runs.get_output_details()]

    def __call__(self, image: Array) -> dict[int, Array]:
        """Return the outputs for an image, float32 side x side x 3, RGB, by their number of values."""
        self._runs.set_tensor(self._input, image[None].astype(np.float32))
        self._runs.invoke()
        found = (self._runs.get_tensor(index)[0] for index in self._outputs)
        return {output.size: output for output in found}


class BlazePose:
    """People of one camera's frames, followed from each frame to the next; see `Detector`."""

    skeleton: ClassVar[Skeleton] = SKELETONS["blazepose"]
    models: ClassVar[tuple[str, ...]] = MODELS

    def __init__(self, model: str) -> None:
        detector, landmarks = find_weights(model)
        self._detector, self._landmarks = _Model(detector), _Model(landmarks)
        self._anchors = _anchors()
        self._followed = list[Crop]()
        self._since = DETECT_EVERY

    def detect(self, image: Array) -> tuple[Array, Array]:
        """Return the people in the next frame (BGR): pixels (n, 33, 2) and confidences (n, 33)."""
        crops = self._followed
        if self._since >= DETECT_EVERY or not crops:
            new = [one for one in self._search(image) if not any(map(one.is_near, crops))]
            crops, self._since = [*crops, *new][:MAX_PEOPLE], 0
        self._since += 1
        people, self._followed = list[tuple[Array, Array]](), []
        for crop in crops:
            pixels, confidence, presence = self._look(image, crop)
            followed = Crop(pixels[CENTRE], pixels[RIM])
            if presence > MIN_PRESENCE and not any(map(followed.is_near, self._followed)):
                self._followed.append(followed)
                people.append((pixels[:CENTRE], confidence[:CENTRE]))
        return (
            np.array([pixels for pixels, _ in people]).reshape(-1, CENTRE, 2),
            np.array([confidence for _, confidence in people]).reshape(-1, CENTRE),
        )

    def _search(self, image: Array) -> list[Crop]:
        """Return the crops around the people of a whole image, the most certain first."""
        height, width = image.shape[:2]
        scale = DETECTOR_PX / max(height, width)
        small = cv2.resize(image, (round(width * scale), round(height * scale)), interpolation=cv2.INTER_AREA)
        corner = (DETECTOR_PX - np.array(small.shape[1::-1])) // 2
        square = np.zeros((DETECTOR_PX, DETECTOR_PX, 3), np.uint8)
        square[corner[1] : corner[1] + small.shape[0], corner[0] : corner[0] + small.shape[1]] = small
        outputs = self._detector(square[..., ::-1] / 127.5 - 1)
        number = len(self._anchors)
        scores = outputs[number].ravel()
        points = (
            outputs[12 * number].reshape(number, 6, 2)[:, [HIP, TOP]] + self._anchors[:, None] * DETECTOR_PX
        )
        pixels = (points - corner) / scale
        found = list[Crop]()
        for place in np.argsort(-scores):
            if scores[place] < np.log(MIN_SCORE / (1 - MIN_SCORE)) or len(found) == MAX_PEOPLE:
                break
            crop = Crop(*pixels[place])
            if not any(map(crop.is_near, found)):
                found.append(crop)
        return found

    def _look(self, image: Array, crop: Crop) -> tuple[Array, Array, float]:
        """Return landmarks (39, 2), px, their confidences (39,), and the probability of a person."""
        warp = crop.image_from_crop
        how = cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR
        square = cv2.warpAffine(image, warp, (LANDMARK_PX, LANDMARK_PX), flags=how)
        outputs = self._landmarks(square[..., ::-1] / 255.0)
        landmarks = outputs[195].reshape(39, 5)
        confidence = 1 / (1 + np.exp(-landmarks[:, 3]))
        return landmarks[:, :2] @ warp[:, :2].T + warp[:, 2], confidence, float(outputs[1].ravel()[0])


def _anchors() -> Array:
    """Return the detector's anchors (2254, 2), as fractions of the image's side."""
    anchors = list[Array]()
    for stride in sorted({*STRIDES}):
        cells = DETECTOR_PX // stride
        rows, columns = np.mgrid[:cells, :cells]
        places = (np.stack([columns.ravel(), rows.ravel()], axis=1) + 0.5) / cells
        anchors.append(np.repeat(places, 2 * STRIDES.count(stride), axis=0))
    return np.concatenate(anchors)
