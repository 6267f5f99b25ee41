"""What the commands make of a session, for Python: the same results with arrays, and nothing printed."""

import shutil
import tempfile
import weakref
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from capture_app.console.usage import silence
from capture_app.session.exporting.point_cloud import PointCloud, read_ply
from capture_app.session.files.strangers import read_arrays
from capture_app.session.reading.decoding import decode_image
from capture_app.session.reading.opened import OpenSession
from capture_app.session.reading.reader import Session
from reconstruction.calibration.command import CalibrateOptions, CalibrateResult, calibrate
from reconstruction.calibration.sources import CalibrationSource
from reconstruction.common.geometry import Array
from reconstruction.compare.comparison import CompareOptions, compare
from reconstruction.multiview.instant_model import FUSED, MultiviewOptions, multiview
from reconstruction.multiview.result import MultiviewResult
from reconstruction.panorama.command import PanoramaOptions, PanoramaResult, panorama
from reconstruction.scores.comparison_results import CompareResult
from reconstruction.stereo.command import StereoDepth, StereoOptions, stereo
from reconstruction.time_offsets.session_offsets import TimeResult, measure_times

R = TypeVar("R")


@dataclass(frozen=True)
class Made(Generic[R]):
    """What a command made: its `result` as --json prints it, and its files in `folder`.

    A folder that nobody asked for is temporary: it is gone when this is.
    """

    result: R
    folder: Path

    def image(self, file: str) -> Array:
        """One of its pictures as it was written; colours are BGR. Raises OSError where there is none."""
        return np.asarray(decode_image(self.folder.joinpath(file).read_bytes()))


class MadeStereo(Made[StereoDepth]):
    """Depth of two cameras, on the pixels of the first, in the result's `unit`."""

    @property
    def depth(self) -> Array:
        """Along the camera's axis, float32 height x width, 0 = none."""
        return self.image(self.result.depth)

    @property
    def filled(self) -> Array:
        """The same with a guess where there is none."""
        return self.image(self.result.depth_filled)

    @property
    def confidence(self) -> Array:
        """Of each depth, float64 height x width, 0 (a guess) to 1."""
        return self.image(self.result.confidence) / 255


class MadeMultiview(Made[MultiviewResult]):
    """Depth of all cameras at an instant, in the result's `unit`, and a cloud in the rig's frame."""

    def depth(self, camera: str) -> Array:
        """Along the camera's axis on its undistorted pixels, float32 height x width, 0 = none."""
        return self._view(camera)["depth"]

    def normals(self, camera: str) -> Array:
        """Of the surfaces in the camera's frame, float16 height x width x 3."""
        return self._view(camera)["normals"]

    @property
    def cloud(self) -> PointCloud:
        """`points` (n, 3) and their `colours` (n, 3), uint8 RGB. Raises IncompleteError for none."""
        return read_ply(self.folder / FUSED)

    def _view(self, camera: str) -> dict[str, Array]:
        return read_arrays(self.folder / "depth" / f"{camera}.npz")


class MadeComparison(Made[CompareResult]):
    """A comparison with pictures that are late; `folder` holds its report.html."""

    def per_instant(self, study: str) -> dict[str, Array]:
        """What a study measured at each instant, float64 by name, NaN = nothing there."""
        found = self.result.study(study)
        rows = found.per_instant if found is not None else ()
        names = dict.fromkeys(name for row in rows for name in row)
        return {name: np.array([row.get(name) for row in rows], np.float64) for name in names}


M = TypeVar("M", bound=Made[Any])


class ReconstructedSession(OpenSession):
    """An open session, with the commands of `reconstruct` as methods; `open_session` makes it.

    `out` is the folder for the files, None a temporary one; `options` are the fields of the options named.
    """

    def stereo(self, out: str | PathLike[str] | None = None, **options: Any) -> MadeStereo:
        """Depth from two cameras at one instant. Options: `StereoOptions`."""
        return _make(MadeStereo, out, lambda folder: stereo(self.folder, folder, StereoOptions(**options)))

    def multiview(self, out: str | PathLike[str] | None = None, **options: Any) -> MadeMultiview:
        """Depth of all cameras at one instant. Options: `MultiviewOptions`."""
        chosen = MultiviewOptions(**options)
        return _make(MadeMultiview, out, lambda folder: multiview(self.folder, folder, chosen))

    def compare(self, out: str | PathLike[str] | None = None, **options: Any) -> MadeComparison:
        """Synchronized pictures against late ones. Options: those of `CompareOptions` and its studies."""
        chosen = CompareOptions.of(**options)
        return _make(MadeComparison, out, lambda folder: compare(self.folder, folder, chosen))

    def panorama(self, out: str | PathLike[str] | None = None, **options: Any) -> Made[PanoramaResult]:
        """The pictures of one instant stitched. Options: `PanoramaOptions`."""
        chosen = PanoramaOptions(**options)
        return _make(Made[PanoramaResult], out, lambda folder: panorama((self.folder,), folder, chosen))

    def time(self, reference: str | None = None, *, apply: bool = False) -> TimeResult:
        """How late each camera is, by a lamp or by what moves; `apply` gives a recording these times."""
        with silence():
            return measure_times(self.folder, reference, apply=apply)

    def calibrate(self, source: str = "sfm", **options: Any) -> CalibrateResult:
        """Calibrate the cameras and save that in the session. Options: `CalibrateOptions`."""
        with silence():
            result = calibrate(
                self.folder, CalibrateOptions(source=CalibrationSource.named(source), **options)
            )
        self.__dict__.pop("cameras", None)
        return result


def open_session(session: str | PathLike[str] | Session) -> ReconstructedSession:
    """Open a session's folder, or one that is open already, to make depth of it.

    Raises BadInputError where it is no session, IncompleteError where its capture never finished.
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
