"""A session's cameras: their calibration, and the pairs that suit depth and panoramas."""

from collections.abc import Container, Iterable
from functools import lru_cache
from pathlib import Path

import numpy as np

from capture_app.errors import BadInputError, NotAvailableError
from capture_app.session.format.calibration import Calibration
from reconstruction.calibration.soundness import refuse_unsound
from reconstruction.calibration.structure_from_motion import calibrate_from_images
from reconstruction.common.geometry import View
from reconstruction.common.stage_cache import StageCache
from reconstruction.pairs.features import Features, detect_features
from reconstruction.pairs.pair_choice import PairChoice, choose_panorama_pair, choose_stereo_pair
from reconstruction.session.dataset import Dataset
from reconstruction.session.mover_detection import SceneMotion


class Rig:
    """The cameras of one session; everything is found once and then fixed for all conditions."""

    def __init__(self, dataset: Dataset, stages: Path, step: int = 1) -> None:
        """`stages` is the folder of the stage cache; `step` as of `SceneMotion`."""
        self.dataset = dataset
        self.motion = SceneMotion(dataset, step)
        self.stages = StageCache(stages, dataset.fingerprint())
        self.views: dict[str, View] = {}
        self.calibration: Calibration | None = None
        self.features = lru_cache(maxsize=4)(self._detect_features)
        """By camera, its features at rest in the image nearest to an instant."""

    @property
    def source(self) -> str:
        """The calibration's source, in words."""
        return self.calibration.source_words if self.calibration else "none"

    @property
    def unit(self) -> str:
        """The unit of length of every depth."""
        return self.calibration.unit if self.calibration else ""

    def calibrate(self) -> None:
        """Set the views: the session's own, else found from its images.

        Raises:
            NotAvailableError: it takes COLMAP, which is not installed here.
            BadInputError: none can be found.
        """
        own = self.dataset.calibration()
        self.use_calibration(own or self.stages.record("calibration", Calibration, self._solve))

    def use_calibration(self, calibration: Calibration) -> None:
        """Set the views from a calibration that is known.

        Raises:
            BadInputError: it was made for images of another shape.
        """
        self.calibration = calibration
        self.views = calibrated_views(self.dataset, calibration)

    def try_calibrate(self) -> NotAvailableError | BadInputError | None:
        """As `calibrate`; the error says why there are no views."""
        try:
            self.calibrate()
        except (NotAvailableError, BadInputError) as error:
            return error
        return None

    def check_pair(self, pair: tuple[str, str] | None) -> None:
        """Refuse a pair of cameras that the session does not have."""
        for name in pair or ():
            self.dataset.session.camera(name)
        if pair is not None and pair[0] == pair[1]:
            raise BadInputError(f"{pair[0]} cannot be paired with itself", hint="name two cameras")

    def choose_stereo_pair(
        self, asked: tuple[str, str] | None, instant: int, among: Container[str] | None = None
    ) -> PairChoice:
        """The pair for depth, asked for or chosen (`among` some) by what both see around an instant."""
        choice = PairChoice(asked, "asked for")
        if asked is None:
            views = {name: view for name, view in self.views.items() if among is None or name in among}
            choice = choose_stereo_pair(views, self.features(instant))
        for name in choice.cameras or ():
            if name not in self.views:
                return PairChoice(None, f"camera {name} has no calibration")
        return choice

    def choose_panorama_pair(self, asked: tuple[str, str] | None, instant: int) -> PairChoice:
        """The pair for a panorama, asked for or chosen by overlap."""
        if asked is not None:
            return PairChoice(asked, "asked for")
        points = self.features(instant)
        return choose_panorama_pair(points, {name: self.dataset.size(name) for name in points})

    def moving_share(self, instants: list[int]) -> float:
        """Largest share of any camera's pixels that move, the mean over these instants."""
        shares = [0.0]
        for name in self.dataset.cameras:
            there = [k for k in instants if self.dataset.has_image(name, k)]
            if there:
                shares.append(float(np.mean([self.motion.detected_movers(name, k).mean() for k in there])))
        return max(shares)

    def _solve(self) -> Calibration:
        return calibrate_from_images(self.dataset, self.motion.widened_movers)

    def _detect_features(self, instant: int) -> dict[str, Features]:
        return features_at_rest(self.motion, self.dataset.cameras, instant)


def features_at_rest(motion: SceneMotion, cameras: Iterable[str], instant: int) -> dict[str, Features]:
    """By camera, features of what stands still in its image nearest to an instant, if it has any image."""
    found = {}
    for name in cameras:
        if there := motion.dataset.instants(name):
            nearest = min(there, key=lambda k: abs(k - instant))
            image, movers = motion.dataset.grey(name, nearest), motion.widened_movers(name, nearest)
            found[name] = detect_features(image, movers)
    return found


def calibrated_views(dataset: Dataset, calibration: Calibration) -> dict[str, View]:
    """The calibrated cameras among the session's, at the size of their images.

    Raises:
        BadInputError: a calibration was made for images of another shape, or by other cameras, or is unsound.
    """
    if not calibration.cameras.keys() & set(dataset.cameras):
        raise BadInputError(
            f"{dataset.name}'s calibration is of other cameras ({', '.join(calibration.cameras)})",
            hint=f"the session has {', '.join(dataset.cameras)}",
        )
    views = {}
    for name in dataset.cameras:
        known = calibration.cameras.get(name)
        if known is None:
            continue
        refuse_unsound(name, known)
        width, height = dataset.size_on_disk(name)
        if abs(known.width / known.height - width / height) > 0.01 * width / height:
            raise BadInputError(
                f"camera {name} is calibrated for {known.width}x{known.height}, "
                f"but its images are {width}x{height}",
                hint="calibrate at the shape of the images",
            )
        views[name] = View.from_calibration(known, *dataset.size(name))
    return views
