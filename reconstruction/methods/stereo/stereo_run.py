"""Depth, confidence and a picture from one pair at one instant."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.console.terminal import Progress
from capture_app.session.format.calibration import LensKnowledge
from reconstruction.common.drawing import colour_depth, display_range, side_by_side
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import save_picture, write_image
from reconstruction.common.memory import ByteCache, memory_budget
from reconstruction.common.options import Pair
from reconstruction.common.outputs import Made
from reconstruction.common.worker_pool import SWEEP_BYTES, worker_count, worker_pool
from reconstruction.method.truth import fraction_right
from reconstruction.methods.stereo.stereo_pair import (
    DepthMap,
    FilledDepthMap,
    StereoPair,
    find_disparity_range,
)
from reconstruction.scene.calibration.consistency import describe_sideways_error, no_measurement, turn_error
from reconstruction.scene.conditions import Condition, evenly_spaced
from reconstruction.scene.instant_choice import instants_shown
from reconstruction.scene.pairs import PairChoice
from reconstruction.scene.provenance import Provenance
from reconstruction.scene.scene import Scene

DEPTH, FILLED, CHECKED, DIFFERENCE = (
    "depth.tiff",
    "depth_filled.tiff",
    "depth_checked.tiff",
    "difference.tiff",
)
CACHE_FRACTION = 0.12
"""Fraction of the memory budget for the depth of a pair's instants."""
BYTES_PER_PIXEL = 150
"""Memory of an instant's matching and checks, per pixel, beside what the matcher reserves."""


class StereoDepth(Provenance, frozen=True, kw_only=True):
    """Result of `reconstruct stereo`: paths relative to the output folder, fractions of all pixels.

    `depth` is float32 in `unit`s along the reference's axis, 0 = unknown. `depth_filled` has a guess in its
    place. `depth_checked` has only what passes stricter checks, which a comparison scores; `difference` is in
    grey levels between both images (NaN = unknown). `confidence` is 0 (a guess) to 255.
    """

    session: str
    reference: str
    other: str
    instant: int
    other_instant: int
    depth: str
    depth_filled: str
    depth_checked: str
    difference: str
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
    lenses: LensKnowledge = LensKnowledge()
    why: str = ""
    left_out: dict[str, str] = msgspec.field(default_factory=dict)
    """Cameras without an image of the instant, with the reason."""
    turn_error: float | None = None
    """Relative error of the median depth by a turn that two cameras do not show."""
    pairs_left_out: dict[str, str] = msgspec.field(default_factory=dict)
    """Reasons why pairs cannot make depth, by the two names separated by a comma."""

    @property
    def basis(self) -> str:
        """What the depth rests on, in words: lenses that are not known well, or what `turn_error` means."""
        warning = "" if self.turn_error is None else describe_sideways_error(self.turn_error)
        return no_measurement(self.lenses) or warning


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


class PairInstant(NamedTuple):
    """Depth of a pair at one instant; `filled` is missing if only the checked depth was asked for."""

    cameras: tuple[str, str]
    instant: int
    other_instant: int
    checked: DepthMap
    filled: FilledDepthMap | None
    pair: StereoPair


def prepare_pair(scene: Scene, cameras: tuple[str, str]) -> StereoPair:
    """Return the matcher of a scene's pair, whose range of disparities all instants and conditions share.

    Raises:
        ValueError: the two views have nothing in common, or cannot be rectified.
    """
    return scene.once(("stereo", cameras), lambda: _prepare_pair(scene, cameras))


def _prepare_pair(scene: Scene, cameras: tuple[str, str]) -> StereoPair:
    dataset, views = scene.dataset, (scene.views[cameras[0]], scene.views[cameras[1]])

    chosen, (first, second) = evenly_spaced(dataset.instants(*cameras), 8), cameras
    images = [(dataset.grey(first, k), dataset.grey(second, k), _moving(scene, first, k)) for k in chosen]
    return StereoPair(*views, find_disparity_range(views, images))


def _checked_depth(scene: Scene, cameras: tuple[str, str]) -> ByteCache:
    """Return the checked depth of a scene's pair by both instants; a comparison asks for most of it again."""
    pair, dataset, (first, second) = prepare_pair(scene, cameras), scene.dataset, cameras

    def make(now: int, later: int) -> Array:
        return np.stack(pair.compute_depth(dataset.grey(first, now), dataset.grey(second, later)))

    limit = int(CACHE_FRACTION * memory_budget().limit_bytes)
    return scene.once(("stereo depth", cameras), lambda: ByteCache(make, limit))


def _moving(scene: Scene, camera: str, instant: int) -> Array:
    if len(scene.dataset.instants(camera)) > 1:
        return scene.motion.detected_moving(camera, instant)
    return np.zeros(scene.dataset.grey(camera, instant).shape, bool)


def match_pair(
    scene: Scene, cameras: tuple[str, str], shown: Sequence[tuple[int, int]], *, lean: bool = False
) -> Iterator[PairInstant]:
    """Yield the depth of a pair for each of these pairs of instants; `lean`: only the checked depth.

    Raises:
        BadInputError: the two views have too little in common.
    """
    dataset, (reference, other) = scene.dataset, cameras
    try:
        pair, checked = prepare_pair(scene, cameras), _checked_depth(scene, cameras)
    except ValueError as error:
        raise BadInputError(
            f"{reference} and {other}: {error}",
            hint="name two overlapping cameras with --pair, or calibrate the rig again",
        ) from error

    def match(instants: tuple[int, int]) -> PairInstant:
        now, later = instants
        if not lean:
            images = dataset.grey(reference, now), dataset.grey(other, later)
            return PairInstant(cameras, now, later, *pair.compute_both(*images), pair)
        return PairInstant(cameras, now, later, DepthMap(*checked(now, later)), None, pair)

    size = BYTES_PER_PIXEL * scene.views[reference].width * scene.views[reference].height
    with worker_pool(worker_count(max(size, SWEEP_BYTES))) as pool:
        yield from pool.map(match, shown)


def choose_pair(scene: Scene, absent: Mapping[str, str], instant: int, asked: Pair | None) -> PairChoice:
    """Return the pair to match; cameras that are `absent`, with the reasons, take no part.

    Raises:
        BadInputError: no pair can be matched, or it lacks an image.
    """
    session = scene.dataset.session.folder
    choice = scene.choose_stereo_pair(asked, instant, set(scene.dataset.cameras) - absent.keys())
    if choice.cameras is None:
        why = "".join(f"; {name}: {text}" for name, text in absent.items())
        raise BadInputError(
            f"no depth can be made from {session}: {choice.why}{why}",
            hint="name two overlapping cameras with --pair, or calibrate the rig again",
        )
    if missing := [name for name in choice.cameras if name in absent]:
        raise BadInputError(
            f"{session} cannot show {missing[0]}: {absent[missing[0]]}",
            hint="choose another --instant, or another --pair",
        )
    return choice


def compute_stereo(
    scene: Scene,
    condition: Condition,
    folder: Path,
    *,
    instant: int,
    asked: Pair | None,
    progress: Progress,
) -> StereoDepth:
    """Match one pair of a session densely; write depth, confidence and a picture to `folder`.

    Raises:
        SimulshotError: the session or the options cannot be used, or the two views overlap too little.
    """
    dataset = scene.dataset
    dataset.require_cameras(2, "depth needs two that see the same from different places")
    progress.total = 3
    asked = scene.named_pair(asked)
    progress.step("calibration")
    scene.calibration  # noqa: B018  (may take long, and may fail)
    progress.step("choosing cameras")
    shown = instants_shown(dataset, condition, instant)
    absent = {
        name: f"it has no image of instant {k}" for name, k in shown.items() if not dataset.has_image(name, k)
    }
    choice = choose_pair(scene, absent, instant, asked)
    assert choice.cameras is not None
    reference, other = choice.cameras
    progress.step(f"stereo {reference}-{other}, instant {shown[reference]}")
    (matched,) = match_pair(scene, choice.cameras, [(shown[reference], shown[other])])
    return msgspec.structs.replace(
        _save_result(scene, matched, folder),
        why=choice.why,
        left_out=absent,
        pairs_left_out=dict(choice.left_out),
    )


def _save_result(scene: Scene, pair: PairInstant, folder: Path) -> StereoDepth:
    assert pair.filled is not None
    depth, filled = pair.filled.depth, pair.filled.filled
    known, reference, instant = depth[depth > 0], pair.cameras[0], pair.instant
    picture = side_by_side(
        scene.dataset.image(reference, instant), colour_depth(depth, *display_range(depth))
    )
    maps = {DEPTH: depth, FILLED: filled, CHECKED: pair.checked.depth, DIFFERENCE: pair.checked.difference}
    for name, values in maps.items():
        write_image(folder / name, values.astype(np.float32))
    truth = scene.dataset.ground_truth(reference, instant)
    judged = truth[0] if truth is not None and scene.unit == "m" else None
    confidence = np.round(255 * pair.filled.confidence).astype(np.uint8)
    return StereoDepth(
        session=str(scene.dataset.session.folder),
        reference=reference,
        other=pair.cameras[1],
        instant=instant,
        other_instant=pair.other_instant,
        depth=DEPTH,
        depth_filled=FILLED,
        depth_checked=CHECKED,
        difference=DIFFERENCE,
        confidence=save_picture(folder, "confidence.png", confidence),
        picture=save_picture(folder, "depth.png", picture),
        unit=scene.unit,
        nearest=float(known.min()) if known.size else 0.0,
        farthest=float(known.max(initial=0.0)),
        coverage=known.size / depth.size,
        within_2pct=None if judged is None else fraction_right(depth, judged),
        filled_within_2pct=None if judged is None else fraction_right(filled, judged),
        calibration=scene.source,
        lenses=scene.lenses,
        turn_error=turn_error(scene.views[reference], scene.views[pair.cameras[1]], depth),
    )
