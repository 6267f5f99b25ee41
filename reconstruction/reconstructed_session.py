"""The commands of `reconstruct` for Python: the same results, with arrays; nothing is printed."""

import shutil
import tempfile
import weakref
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.console.usage import silence
from capture_app.session.exporting.point_cloud import PointCloud, read_ply
from capture_app.session.files.untrusted_files import read_arrays
from capture_app.session.reading.array_access import OpenSession
from capture_app.session.reading.decoding import decode_image
from capture_app.session.reading.reader import Session
from reconstruction.calibration.calibrated_rig import calibrated_views
from reconstruction.calibration.calibration_run import CalibrateOptions, CalibrateResult, calibrate
from reconstruction.common.geometry import Array
from reconstruction.compare.comparison import CompareOptions, compare
from reconstruction.depth.live_depth import LiveDepth
from reconstruction.multiview.instant_model import FUSED, MultiviewOptions, multiview
from reconstruction.multiview.result import MultiviewResult
from reconstruction.panorama.panorama_run import PanoramaOptions, PanoramaResult, panorama
from reconstruction.scores.comparison_results import CompareResult
from reconstruction.session.dataset import Dataset
from reconstruction.session.moving_pixels import SceneMotion
from reconstruction.stereo.stereo_run import StereoDepth, StereoOptions, stereo
from reconstruction.time_offsets.session_offsets import TimeResult, measure_times

R = TypeVar("R")


@dataclass(frozen=True)
class Made(Generic[R]):
    """Result of a command: `result` as --json prints it, and its files in `folder`.

    A folder that the caller did not name is temporary. It is deleted with this object.
    """

    result: R
    folder: Path

    def image(self, file: str) -> Array:
        """Return an image file as an array; colours are BGR. Raises OSError if the file does not exist."""
        return np.asarray(decode_image(self.folder.joinpath(file).read_bytes()))


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


class MadeMultiview(Made[MultiviewResult]):
    """Depth of all cameras at one instant, in the result's `unit`, and a point cloud in the rig's frame."""

    def depth(self, camera: str) -> Array:
        """Return depth along the axis on undistorted pixels, float32 height x width, 0 = unknown."""
        return self._view(camera)["depth"]

    def normals(self, camera: str) -> Array:
        """Return surface normals in the camera's frame, float16 height x width x 3."""
        return self._view(camera)["normals"]

    @property
    def cloud(self) -> PointCloud:
        """Fused cloud: `points` (n, 3), `colours` (n, 3), uint8 RGB. Raises IncompleteError if missing."""
        return read_ply(self.folder / FUSED)

    def _view(self, camera: str) -> dict[str, Array]:
        return read_arrays(self.folder / "depth" / f"{camera}.npz")


class MadeComparison(Made[CompareResult]):
    """Comparison of synchronized with offset images; `folder` holds its report.html."""

    def per_instant(self, study: str) -> dict[str, Array]:
        """Return a study's measurements at each instant, float64 by name, NaN = not measured."""
        found = self.result.study(study)
        rows = found.per_instant if found is not None else ()
        return {
            name: np.array([row.get(name) for row in rows], np.float64)
            for name in dict.fromkeys(name for row in rows for name in row)
        }


M = TypeVar("M", bound=Made[Any])


class ReconstructedSession(OpenSession):
    """Open session with the commands of `reconstruct` as methods; `open_session` returns it.

    `out` is the output folder; None = a temporary folder that goes with the result.
    """

    def stereo(
        self, options: StereoOptions | None = None, *, out: str | PathLike[str] | None = None
    ) -> MadeStereo:
        """Compute depth from two cameras at one instant."""
        return _make(MadeStereo, out, lambda to: stereo(self.folder, to, options or StereoOptions()))

    def multiview(
        self, options: MultiviewOptions | None = None, *, out: str | PathLike[str] | None = None
    ) -> MadeMultiview:
        """Compute depth of all cameras at one instant."""
        return _make(MadeMultiview, out, lambda to: multiview(self.folder, to, options or MultiviewOptions()))

    def compare(
        self, options: CompareOptions | None = None, *, out: str | PathLike[str] | None = None
    ) -> MadeComparison:
        """Compare synchronized with offset images; `CompareOptions.of` takes the studies' options, too."""
        return _make(MadeComparison, out, lambda to: compare(self.folder, to, options or CompareOptions()))

    def panorama(
        self, options: PanoramaOptions | None = None, *, out: str | PathLike[str] | None = None
    ) -> Made[PanoramaResult]:
        """Stitch the images of one instant."""
        return _make(
            Made[PanoramaResult], out, lambda to: panorama((self.folder,), to, options or PanoramaOptions())
        )

    def moving(self, camera: str, instant: int) -> Array:
        """Return what moves in a camera's frame, bool height x width, seen by comparing its instants.

        Raises as `frame` and `Frame.bgr` do, and NotApplicableError if the camera has one frame only.
        """
        found = self.frame(camera, instant).record
        self._motion.require_several_images([camera])
        return self._motion.detected_moving(found.camera, found.instant)

    def live_depth(self, width_px: int = 320) -> LiveDepth:
        """Return what computes depth of this rig's previews, by this session's calibration.

        Raises BadInputError if it has none.
        """
        dataset = Dataset.open(self.folder)
        if (calibration := dataset.calibration()) is None:
            raise BadInputError(f"{dataset.name} has no calibration", hint="calibrate() computes one")
        return LiveDepth(calibrated_views(dataset, calibration), width_px)

    def time(self, reference: str | None = None, *, apply: bool = False) -> TimeResult:
        """Measure each camera's time offset by a lamp or motion; `apply` corrects the recording's times."""
        with silence():
            return measure_times(self.folder, reference, apply=apply)

    def calibrate(self, options: CalibrateOptions | None = None) -> CalibrateResult:
        """Calibrate the cameras and save the calibration in the session."""
        with silence():
            result = calibrate(self.folder, options or CalibrateOptions())
        for stale in ("cameras", "_motion"):
            self.__dict__.pop(stale, None)
        return result

    @cached_property
    def _motion(self) -> SceneMotion:
        return SceneMotion(Dataset.open(self.folder), step=1)


def open_session(session: str | PathLike[str] | Session) -> ReconstructedSession:
    """Open a session's folder, or a session that is already open, for reconstruction.

    Raises BadInputError if it is not a session, IncompleteError if its capture never finished.
    """
    return ReconstructedSession.open(session.folder if isinstance(session, Session) else Path(session))


def _make(kind: type[M], out: str | PathLike[str] | None, run: Callable[[Path], Any]) -> M:
    with ExitStack() as undone, silence():
        if out is not None:
            return kind(run(Path(out)), Path(out))
        scratch = tempfile.mkdtemp(prefix="simulshot-")
        undone.callback(shutil.rmtree, scratch, ignore_errors=True)
        made = kind(run(Path(scratch, "made")), Path(scratch, "made"))
        weakref.finalize(made, undone.pop_all().close)
        return made
