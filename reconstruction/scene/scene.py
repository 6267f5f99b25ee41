"""Scene: a session and what is known of it, chosen once: images, calibration, views, motion, features."""

import threading
from collections.abc import Callable, Container, Hashable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from pathlib import Path
from typing import Any, Self, TypeVar, cast

import numpy as np

from capture_app.common.errors import BadInputError, NotAvailableError
from capture_app.session.format.calibration import Calibration, LensKnowledge
from capture_app.session.format.camera_labels import require_camera
from reconstruction.common.geometry import View
from reconstruction.scene.calibration.consistency import CalibrationCheck, check_rig
from reconstruction.scene.calibration.soundness import calibrated_views
from reconstruction.scene.calibration.stored import choose_calibration, known_calibration
from reconstruction.scene.calibration.structure_from_motion import guess_calibration
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.features_at_rest import SceneFeatures
from reconstruction.scene.moving_pixels import SceneMotion
from reconstruction.scene.pairs import PairChoice, choose_panorama_pair, choose_stereo_pair

T = TypeVar("T")


class Scene:
    """A session, its calibration and unit, the views of its cameras, and what moves.

    Nothing in it changes. What takes long is computed when it is first asked for, once.
    """

    def __init__(
        self, dataset: Dataset, calibration: Calibration | None = None, scale_error: float = 0.0
    ) -> None:
        """`calibration` replaces that of the session or its rig.

        `scale_error` is the relative standard deviation of the calibration's scale; 0 = as exact as its
        poses.
        """
        self.dataset, self.scale_error = dataset, scale_error
        self.motion = SceneMotion(dataset, 1)
        self.features = self._features = SceneFeatures(self.motion)
        self._replaced = calibration
        self._made, self._locks = dict[Hashable, Any](), dict[Hashable, threading.RLock]()

    def once(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what `make` returns for a key; runs of one scene share it."""
        with self._locks.setdefault(key, threading.RLock()):
            if key not in self._made:
                self._made[key] = make()
        return cast("T", self._made[key])

    @classmethod
    def open(cls, folder: Path, shifts_ms: Mapping[str, float] | None = None) -> Self:
        """Open a session's folder; `shifts_ms` is as in `Dataset`. Images of fisheyes are redrawn straight.

        Raises:
            SimulshotError: the session or its images cannot be used.
        """
        dataset = Dataset.open(folder, shifts_ms)
        known = known_calibration(dataset)
        return cls(dataset if known is None else dataset.straightened(known))

    @classmethod
    def open_raw(cls, folder: Path) -> Self:
        """Open a session's folder with all images as they were taken, to calibrate it; raises as `open`."""
        return cls(Dataset.open(folder))

    @property
    def given(self) -> Calibration | None:
        """The calibration of the session or its rig, None without; raises as `choose_calibration`."""
        return self._replaced or self.once("given", lambda: choose_calibration(self._features))

    def calibrated(self, calibration: Calibration | None, scale_error: float = 0.0) -> "Scene":
        """Return the same session with another calibration; None = without a change."""
        other = copy(self)
        other._replaced, other.scale_error = calibration or self.given, scale_error
        other._made, other._locks = {}, {}
        return other

    def moving_over(self, step: int) -> "Scene":
        """Return the scene in which moves what moves within `step` instants: for scores, not for methods."""

        def make() -> Scene:
            other = copy(self)
            other.motion = SceneMotion(self.dataset, step)
            # What stands still is the same over any time.
            other.motion.background = self.motion.background
            other.features = SceneFeatures(other.motion, self.features)
            return other

        return self if step == self.motion.step else self.once(("moving over", step), make)

    def fitted(self, **work: Any) -> "Scene":
        """Return the scene at a size that fits the memory budget; see `Dataset.fitted`."""
        dataset = self.dataset.fitted(**work)
        if dataset is self.dataset:
            return self
        return Scene(dataset, self.given, self.scale_error)

    @property
    def calibration(self) -> Calibration:
        """The given calibration, else one from the images.

        Raises:
            NotAvailableError: COLMAP is required and is not installed here.
            BadInputError: no calibration can be found.
        """
        return self._require()[0]

    @property
    def views(self) -> Mapping[str, View]:
        """The views of the calibrated cameras; raises as `calibration`."""
        return self._require()[1]

    @property
    def known_views(self) -> Mapping[str, View]:
        """The views of the calibrated cameras; empty if no calibration can be found."""
        return {} if self.problem else self.views

    @property
    def given_views(self) -> Mapping[str, View]:
        """The views by the given calibration; empty if none was given."""
        return {} if self.given is None else self.views

    @property
    def problem(self) -> str:
        """Why no calibration can be found; empty if one is."""
        calibrated = self._calibrated
        return str(calibrated) if isinstance(calibrated, Exception) else ""

    @property
    def source(self) -> str:
        """Description of the calibration's source."""
        return "none" if self.problem else self.calibration.source_words

    @property
    def check(self) -> CalibrationCheck:
        """The check of the calibration against points at rest; raises as `calibration`."""

        def make() -> CalibrationCheck:
            with suppress(BadInputError):
                return check_rig(self.views, self.features.middle, self.calibration.known_lenses)
            return check_rig(self.views, {})

        return self.once("check", make)

    @property
    def lenses(self) -> LensKnowledge:
        """How well the focal lengths are known: by what their calibration states, and by points at rest."""
        known = LensKnowledge() if self.problem else self.calibration.known_lenses
        # Focal lengths that these images gave are judged already.
        if self.problem or self.given is None or known.level == "not":
            return known
        wrong, is_simulated = self.check.by_lenses, self.dataset.session.manifest.origin == "simulated"
        if wrong or not (known.why or is_simulated or self.check.confirms_lenses):
            return LensKnowledge(
                level="not" if wrong else "roughly",
                why=wrong or "these pictures do not confirm those that were given",
            )
        return known

    @property
    def unit(self) -> str:
        """The unit of length of every depth."""
        return "" if self.problem else self.calibration.unit

    @property
    def _calibrated(self) -> tuple[Calibration, dict[str, View]] | BadInputError | NotAvailableError:
        return self.once("calibrated", self._calibrate)

    def _require(self) -> tuple[Calibration, dict[str, View]]:
        calibrated = self._calibrated
        if isinstance(calibrated, Exception):
            raise calibrated
        return calibrated

    def _calibrate(self) -> tuple[Calibration, dict[str, View]] | BadInputError | NotAvailableError:
        try:
            # Every command calibrates a session by the same points at rest, whatever images it compares.
            calibration = self.given or guess_calibration(self._features.motion)
            return calibration, calibrated_views(self.dataset, calibration)
        except (BadInputError, NotAvailableError) as error:
            return error

    def named_pair(self, pair: tuple[str, str] | None) -> tuple[str, str] | None:
        """Return the names of two cameras that a person means; BadInputError if they are not two here."""
        if pair is None:
            return None
        first, second = (require_camera(text, self.dataset.labels, "--pair") for text in pair)
        if first == second:
            raise BadInputError(f"{pair[0]} cannot be paired with itself", hint="name two cameras")
        return first, second

    def choose_stereo_pair(
        self, asked: tuple[str, str] | None, instant: int, among: Container[str] | None = None
    ) -> PairChoice:
        """Return the requested pair for depth, else a chosen one.

        The choice (`among` some cameras) is by the points that both see around an instant.
        """
        for name in asked or ():
            if name not in self.known_views:
                own = self.dataset.session.calibration()
                is_left_out = own is not None and name in own.cameras
                lacks = "is left out, as its calibration is wrong" if is_left_out else "has no calibration"
                return PairChoice(None, f"camera {self.dataset.labels.get(name, name)} {lacks}")
        if asked is not None:
            return PairChoice(asked, "asked for")
        views = {name: view for name, view in self.known_views.items() if among is None or name in among}
        return choose_stereo_pair(views, self.features.at_rest(instant))

    def choose_panorama_pair(self, asked: tuple[str, str] | None, instant: int) -> PairChoice:
        """Return the requested pair for a panorama, else one chosen by overlap."""
        if asked is not None:
            return PairChoice(asked, "asked for")
        points = self.features.at_rest(instant)
        return choose_panorama_pair(points, {name: self.dataset.size(name) for name in points})

    def moving_share(self, instants: Sequence[int]) -> float:
        """Return the largest fraction of moving pixels of any camera, averaged over these instants."""
        there = {c: [k for k in instants if self.dataset.has_image(c, k)] for c in self.dataset.cameras}
        shares = {
            c: [self.motion.detected_moving(c, k).mean() for k in pixels]
            for c, pixels in there.items()
            if pixels
        }
        return max((float(np.mean(fraction)) for fraction in shares.values()), default=0.0)
