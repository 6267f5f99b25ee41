"""Depth, confidence and a picture from one pair at one instant."""

from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.console.terminal import Progress
from reconstruction.common.drawing import colour_depth, display_range, side_by_side
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import save_picture, write_image
from reconstruction.common.outputs import Made
from reconstruction.methods.stereo.stereo_method import Stereo
from reconstruction.methods.stereo.stereo_pair import FilledDepthMap, StereoPair, find_disparity_range
from reconstruction.scene.conditions import Condition
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.provenance import Provenance
from reconstruction.scene.scene import Scene
from reconstruction.scores.truth import fraction_right

DEPTH = "depth.tiff"
FILLED = "depth_filled.tiff"


class StereoDepth(Provenance, frozen=True, kw_only=True):
    """Result of `reconstruct stereo`: paths relative to the output folder, fractions of all pixels.

    `depth` is float32 in `unit`s along the reference's axis, 0 = unknown. `depth_filled` has a guess in its
    place. `confidence` is 0 (a guess) to 255.
    """

    session: str
    reference: str
    other: str
    instant: int
    other_instant: int
    depth: str
    depth_filled: str
    confidence: str
    picture: str
    unit: str
    nearest: float
    farthest: float
    coverage: float
    within_2pct: float | None
    """Fraction of right depths over pixels with a true depth; empty ones count as wrong."""
    filled_within_2pct: float | None
    """Fraction of these pixels whose filled depth is right."""
    calibration: str
    why: str = ""
    left_out: dict[str, str] = msgspec.field(default_factory=dict)
    """Cameras without an image of the instant, with the reason."""
    pairs_left_out: dict[str, str] = msgspec.field(default_factory=dict)
    """Reasons why pairs cannot make depth, by the two names separated by a comma."""


class MadeStereo(Made[StereoDepth]):
    """Depth from two cameras, on the pixels of the first, in the result's `unit`."""

    @property
    def depth(self) -> Array:
        """Depth along the camera's axis, float32 height x width, 0 = unknown."""
        return self.image(self.result.depth)

    @property
    def filled(self) -> Array:
        """Depth as in `depth`, with unknown pixels filled by a guess."""
        return self.image(self.result.depth_filled)

    @property
    def confidence(self) -> Array:
        """Confidence of each pixel's depth, float64 height x width, 0 (a guess) to 1."""
        return self.image(self.result.confidence) / 255


def compute_stereo(
    scene: Scene, condition: Condition, options: Stereo, folder: Path, progress: Progress
) -> StereoDepth:
    """Match one pair of a session densely; write depth, confidence and a picture to `folder`.

    Raises:
        SimulshotError: the session or the options cannot be used, or the two views overlap too little.
    """
    dataset = scene.dataset
    session = dataset.session.folder
    dataset.require_cameras(2, "depth needs two that see the same from different places")
    progress.total = 3
    scene.check_pair(options.pair)
    progress.step("calibration")
    scene.calibration  # noqa: B018  (may take long, and may fail)
    progress.step("choosing cameras")
    instant, later = options.instant, options.other_instant
    shown = dataset.nearest_instants(instant, condition.offsets_ms(dataset.cameras, instant))
    left_out = _without_image(
        dataset, {name: {instant, own, own if later is None else later} for name, own in shown.items()}
    )
    choice = scene.choose_stereo_pair(options.pair, instant, set(dataset.cameras) - left_out.keys())
    if choice.cameras is None:
        absent = "".join(f"; {name}: {why}" for name, why in left_out.items())
        raise BadInputError(
            f"no depth can be made from {session}: {choice.why}{absent}",
            hint="name two overlapping cameras with --pair, or calibrate the rig again",
        )
    reference, other = choice.cameras
    now, later = shown[reference], shown[other] if later is None else later
    for name, needed in ((reference, now), (other, later), (other, now)):
        if not dataset.has_image(name, needed):
            raise BadInputError(
                f"{session} has no image of {name} at instant {needed}",
                hint=f"it has instants 0 to {len(dataset.instants_ns) - 1}",
            )
    progress.step(f"stereo {reference}-{other}, instant {now}")
    try:
        found = _match_pair(scene, choice.cameras, now, later)
    except ValueError as error:
        raise BadInputError(
            f"{reference} and {other}: {error}",
            hint="name two overlapping cameras with --pair, or calibrate the rig again",
        ) from error
    return msgspec.structs.replace(
        _save_result(scene, choice.cameras, (now, later), found, folder),
        why=choice.why,
        left_out=left_out,
        pairs_left_out=dict(choice.left_out),
    )


def _without_image(dataset: Dataset, needed: Mapping[str, set[int]]) -> dict[str, str]:
    """Return the cameras that lack an image of one of the instants they need, with the instant."""
    lacks = {name: [k for k in sorted(ks) if not dataset.has_image(name, k)] for name, ks in needed.items()}
    return {name: f"it has no image of instant {which[0]}" for name, which in lacks.items() if which}


def _match_pair(scene: Scene, cameras: tuple[str, str], instant: int, later: int) -> FilledDepthMap:
    views = scene.views[cameras[0]], scene.views[cameras[1]]
    # The range belongs to the scene: it is found in images of one instant, whatever instant is matched.
    image, other = (scene.dataset.grey(name, instant) for name in cameras)
    moving = (
        scene.motion.detected_moving(cameras[0], instant)
        if len(scene.dataset.instants_ns) > 1
        else np.zeros(image.shape, bool)
    )
    pair = StereoPair(*views, find_disparity_range(views, [(image, other, moving)]))
    return pair.compute_filled_depth(image, scene.dataset.grey(cameras[1], later))


def _save_result(
    scene: Scene, cameras: tuple[str, str], instants: tuple[int, int], found: FilledDepthMap, folder: Path
) -> StereoDepth:
    depth, known = found.depth, found.depth[found.depth > 0]
    picture = side_by_side(
        scene.dataset.image(cameras[0], instants[0]), colour_depth(depth, *display_range(depth))
    )
    write_image(folder / DEPTH, depth.astype(np.float32))
    write_image(folder / FILLED, found.filled.astype(np.float32))
    truth = scene.dataset.ground_truth(cameras[0], instants[0])
    judged = truth[0] if truth is not None and scene.unit == "m" else None
    return StereoDepth(
        session=str(scene.dataset.session.folder),
        reference=cameras[0],
        other=cameras[1],
        instant=instants[0],
        other_instant=instants[1],
        depth=DEPTH,
        depth_filled=FILLED,
        confidence=save_picture(folder, "confidence.png", np.round(255 * found.confidence).astype(np.uint8)),
        picture=save_picture(folder, "depth.png", picture),
        unit=scene.unit,
        nearest=float(known.min()) if known.size else 0.0,
        farthest=float(known.max(initial=0.0)),
        coverage=known.size / depth.size,
        within_2pct=None if judged is None else fraction_right(depth, judged),
        filled_within_2pct=None if judged is None else fraction_right(found.filled, judged),
        calibration=scene.source,
    )
