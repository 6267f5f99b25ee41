"""Joints in images: what a detector finds in a session's frames, and the interface of detectors."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import ClassVar, Protocol

from capture_app.common import system
from capture_app.common.errors import BadInputError
from capture_app.common.plugins import load_plugin
from capture_app.console.terminal import Progress
from reconstruction.common.geometry import Array
from reconstruction.methods.people.skeletons import Skeleton
from reconstruction.scene.dataset import Dataset

DETECTORS = "simulshot.keypoints"
"""Entry points of detectors."""


@dataclass(frozen=True, eq=False)
class FrameJoints:
    """Individuals in one frame: pixels (n, joints, 2) of the session's image, and confidences (n, joints).

    What is not seen has confidence 0. `names` are equal for an individual in all frames of its camera; empty
    if the source does not follow individuals.
    """

    pixels: Array
    confidence: Array
    names: tuple[str, ...] = ()


CameraJoints = Mapping[int, FrameJoints]
"""Individuals in a camera's frames, by instant."""


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Joints in all frames of a session, by camera."""

    skeleton: Skeleton
    cameras: Mapping[str, CameraJoints]
    source: str
    """What found them, for people."""


class Detector(Protocol):
    """A detector of joints, an entry point of `simulshot.keypoints`; one object serves one camera."""

    skeleton: ClassVar[Skeleton]
    models: ClassVar[Sequence[str]]
    """Names of its models for `--model`, the default first; may be empty."""
    search_every_s: float
    """Time after which it looks for new people; may be set."""

    def __init__(self, model: str) -> None:
        """Load a model; raises NotAvailableError if something is not installed."""

    def detect(self, image: Array, at_s: float) -> tuple[Array, Array]:
        """Return the individuals of the camera's next frame (BGR uint8), taken at a time in s.

        Pixels are (n, joints, 2), confidences (n, joints) from 0 to 1.
        """


def load_detector(name: str, model: str) -> type[Detector]:
    """Return an installed detector; raises BadInputError if it, or its model, does not exist."""
    detector: type[Detector] = load_plugin(DETECTORS, name, "skeleton", "models", "detect")
    if model and model not in detector.models:
        known = ", ".join(detector.models) or "it has one only"
        raise BadInputError(f"the detector {name} has no model {model!r}", hint=f"--model: {known}")
    return detector


def detect_people(
    dataset: Dataset, cameras: Sequence[str], name: str, model: str, progress: Progress
) -> Keypoints:
    """Find people in all frames of these cameras, some cameras side by side.

    Raises:
        BadInputError: the detector is not installed, or has no such model.
        NotAvailableError: its runtime or its weights are not on this machine.
    """
    kind = load_detector(name, model)
    model = model or next(iter(kind.models), "")
    # Opened before the threads, so that what is missing is said once.
    detectors = {camera: kind(model) for camera in cameras}

    def follow(camera: str) -> CameraJoints:
        detect = detectors[camera].detect
        joints = {
            k: FrameJoints(*detect(dataset.image(camera, k), dataset.record(camera, k).leader_ns / 1e9))
            for k in dataset.instants(camera)
        }
        progress.step(f"people in {len(joints)} frames of {camera}")
        return joints

    with ThreadPoolExecutor(len(system.usable_cores())) as pool:
        followed = dict(zip(cameras, pool.map(follow, cameras), strict=True))
    return Keypoints(kind.skeleton, followed, f"{name} ({model})" if model else name)
