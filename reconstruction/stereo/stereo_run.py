"""`reconstruct stereo`: depth, confidence and a picture from one pair at one instant."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.console.terminal import Progress
from reconstruction.calibration.calibrated_rig import Rig
from reconstruction.calibration.stored import choose_calibration
from reconstruction.common.drawing import colour_depth, display_range, side_by_side
from reconstruction.common.image_files import save_picture, write_image
from reconstruction.common.outputs import STAGES, comparison_folder, write_metrics
from reconstruction.scores.truth import fraction_right
from reconstruction.session.dataset import Dataset
from reconstruction.session.provenance import Provenance, with_provenance
from reconstruction.stereo.stereo_pair import FilledDepthMap, StereoPair, find_disparity_range

DEPTH = "depth.tiff"
FILLED = "depth_filled.tiff"


@dataclass(frozen=True, kw_only=True)
class StereoOptions:
    """Options of a pair's depth; `pair` None = chosen, `other_instant` None = the same instant."""

    instant: int = 0
    other_instant: int | None = None
    pair: tuple[str, str] | None = None
    time_shifts_ms: Mapping[str, float] = field(default_factory=dict)
    """Corrections added to the times of the named cameras."""


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


def stereo(session: Path, out: Path, options: StereoOptions) -> StereoDepth:
    """Match one pair of a session densely; write depth, confidence and a picture to `out`.

    Raises:
        SimulshotError: the session or the options cannot be used, or the two views overlap too little.
    """
    began = time.monotonic()
    dataset = Dataset.open(session, options.time_shifts_ms)
    dataset.require_cameras(2, "depth needs two that see the same from different places")
    choose_calibration(dataset)
    with comparison_folder(out) as output:
        progress = Progress(3)
        rig = Rig(dataset, output.folder / STAGES)
        rig.check_pair(options.pair)
        progress.step("calibration")
        rig.calibrate()
        progress.step("choosing cameras")
        later = options.instant if options.other_instant is None else options.other_instant
        left_out = _without_image(dataset, {options.instant, later})
        choice = rig.choose_stereo_pair(options.pair, options.instant, set(dataset.cameras) - left_out.keys())
        if choice.cameras is None:
            absent = "".join(f"; {name}: {why}" for name, why in left_out.items())
            raise BadInputError(
                f"no depth can be made from {session}: {choice.why}{absent}",
                hint="name two overlapping cameras with --pair, or calibrate the rig again",
            )
        reference, other = choice.cameras
        for name, instant in ((reference, options.instant), (other, later), (other, options.instant)):
            if not dataset.has_image(name, instant):
                raise BadInputError(
                    f"{session} has no image of {name} at instant {instant}",
                    hint=f"it has instants 0 to {len(dataset.instants_ns) - 1}",
                )
        progress.step(f"stereo {reference}-{other}, instant {options.instant}")
        try:
            found = _match_pair(rig, choice.cameras, options.instant, later)
        except ValueError as error:
            raise BadInputError(
                f"{reference} and {other}: {error}",
                hint="name two overlapping cameras with --pair, or calibrate the rig again",
            ) from error
        result = msgspec.structs.replace(
            _save_result(rig, choice.cameras, (options.instant, later), found, output.folder),
            session=str(session),
            why=choice.why,
            left_out=left_out,
            pairs_left_out=dict(choice.left_out),
        )
        result = with_provenance(result, began, options.time_shifts_ms)
        write_metrics(output.folder, result)
    return result


def _without_image(dataset: Dataset, instants: set[int]) -> dict[str, str]:
    """Return the cameras that lack an image of one of these instants, with the instant."""
    lacks = {name: sorted(k for k in instants if not dataset.has_image(name, k)) for name in dataset.cameras}
    return {name: f"it has no image of instant {which[0]}" for name, which in lacks.items() if which}


def _match_pair(rig: Rig, cameras: tuple[str, str], instant: int, later: int) -> FilledDepthMap:
    views = rig.views[cameras[0]], rig.views[cameras[1]]
    # The range belongs to the scene: it is found in images of one instant, whatever instant is matched.
    image, other = (rig.dataset.grey(name, instant) for name in cameras)
    moving = (
        rig.motion.detected_moving(cameras[0], instant)
        if len(rig.dataset.instants_ns) > 1
        else np.zeros(image.shape, bool)
    )
    pair = StereoPair(*views, find_disparity_range(views, [(image, other, moving)]))
    return pair.compute_filled_depth(image, rig.dataset.grey(cameras[1], later))


def _save_result(
    rig: Rig, cameras: tuple[str, str], instants: tuple[int, int], found: FilledDepthMap, folder: Path
) -> StereoDepth:
    depth, known = found.depth, found.depth[found.depth > 0]
    picture = side_by_side(
        rig.dataset.image(cameras[0], instants[0]), colour_depth(depth, *display_range(depth))
    )
    write_image(folder / DEPTH, depth.astype(np.float32))
    write_image(folder / FILLED, found.filled.astype(np.float32))
    truth = rig.dataset.ground_truth(cameras[0], instants[0])
    judged = truth[0] if truth is not None and rig.unit == "m" else None
    return StereoDepth(
        session=rig.dataset.name,
        reference=cameras[0],
        other=cameras[1],
        instant=instants[0],
        other_instant=instants[1],
        depth=DEPTH,
        depth_filled=FILLED,
        confidence=save_picture(folder, "confidence.png", np.round(255 * found.confidence).astype(np.uint8)),
        picture=save_picture(folder, "depth.png", picture),
        unit=rig.unit,
        nearest=float(known.min()) if known.size else 0.0,
        farthest=float(known.max(initial=0.0)),
        coverage=known.size / depth.size,
        within_2pct=None if judged is None else fraction_right(depth, judged),
        filled_within_2pct=None if judged is None else fraction_right(found.filled, judged),
        calibration=rig.source,
    )
