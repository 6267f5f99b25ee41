"""The commands of `reconstruct` for Python: the same results, with arrays; nothing is printed."""

import shutil
import tempfile
import weakref
from collections.abc import Callable
from contextlib import ExitStack
from functools import cached_property, partial
from os import PathLike
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from msgspec import structs

from capture_app.common.errors import BadInputError
from capture_app.console.usage import silence
from capture_app.session.reading.array_access import OpenSession
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import Array
from reconstruction.common.options import described
from reconstruction.common.outputs import Made
from reconstruction.compare.comparison import CompareOptions, compare
from reconstruction.depth.live_depth import LiveDepth
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.interface import Method, methods
from reconstruction.scene.calibration_run import CalibrateOptions, CalibrateResult, calibrate
from reconstruction.scene.conditions import SYNCHRONIZED, Condition
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets.session_offsets import TimeResult, measure_times


class MadeComparison(Made[CompareResult]):
    """Comparison of synchronized with offset images; `folder` holds its report.html."""

    def per_instant(self, study: str) -> dict[str, Array]:
        """Return a study's measurements at each instant, float64 by name, NaN = not measured."""
        result = self.result.study(study)
        rows = result.per_instant if result is not None else ()
        return {
            name: np.array([row.get(name) for row in rows], np.float64)
            for name in dict.fromkeys(name for row in rows for name in row)
        }


M = TypeVar("M", bound=Made[Any])


class ReconstructedSession(OpenSession):
    """Open session with the commands of `reconstruct` as methods; `open_session` returns it.

    So is every installed method: `stereo`, `multiview`, `panorama`. Each takes its options by name, or as an
    object such as `Stereo(instant=2)`, and a `condition`. `out` is the output folder; None = a temporary
    folder that goes with the result.
    """

    if not TYPE_CHECKING:  # A type checker knows our methods by `__init__.pyi`, and finds misspelled names.

        def __getattr__(self, name: str) -> Callable[..., Any]:
            """Return the method of this name, bound to the session; AttributeError if there is none."""
            if name.startswith("_") or not (method := methods().get(name)):
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            return _documented(partial(self._run, method), method)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *methods()]

    def _run(
        self,
        method: type[Method],
        options: Method | None = None,
        *,
        condition: Condition = SYNCHRONIZED,
        out: str | PathLike[str] | None = None,
        **chosen: Any,
    ) -> Made[Any]:
        run = structs.replace(method() if options is None else options, **chosen).make
        return _make(resolve_name(method.made), out, lambda to: run([self.folder], to, condition))

    def compare(
        self, options: CompareOptions | None = None, *, out: str | PathLike[str] | None = None
    ) -> MadeComparison:
        """Compare synchronized with offset images; `CompareOptions.of` takes the studies' options, too."""
        return _make(MadeComparison, out, lambda to: compare(self.folder, to, options or CompareOptions()))

    def moving(self, camera: str, instant: int) -> Array:
        """Return what moves in a camera's frame, bool height x width, seen by comparing its instants.

        Raises as `frame` and `Frame.bgr` do, and NotApplicableError if the camera has one frame only.
        """
        record = self.frame(camera, instant).record
        self._scene.motion.require_several_images([camera])
        return self._scene.motion.detected_moving(record.camera, record.instant)

    def live_depth(self, width_px: int = 320) -> LiveDepth:
        """Return what computes depth of this rig's previews, by this session's calibration.

        Raises BadInputError if it has none.
        """
        if self._scene.given is None:
            raise BadInputError(f"{self.name} has no calibration", hint="calibrate() computes one")
        return LiveDepth(self._scene.views, width_px)

    def time(self, reference: str | None = None, *, apply: bool = False) -> TimeResult:
        """Measure each camera's time offset by a lamp or motion; `apply` corrects the recording's times."""
        with silence():
            return measure_times(self.folder, reference, apply=apply)

    def calibrate(self, options: CalibrateOptions | None = None) -> CalibrateResult:
        """Calibrate the cameras and save the calibration in the session."""
        with silence():
            result = calibrate(self.folder, options or CalibrateOptions())
        for stale in ("cameras", "_scene"):
            self.__dict__.pop(stale, None)
        return result

    @cached_property
    def _scene(self) -> Scene:
        return Scene.open(self.folder)


def open_session(session: str | PathLike[str] | Session) -> ReconstructedSession:
    """Open a session's folder, or a session that is already open, for reconstruction.

    Raises BadInputError if it is not a session, IncompleteError if its capture never finished.
    """
    return ReconstructedSession.open(session.folder if isinstance(session, Session) else Path(session))


def _documented(run: partial[Any], method: type[Method]) -> Callable[..., Any]:
    """Return a function that runs a method, with the help and the options of its command."""

    def bound(
        options: Method | None = None,
        *,
        condition: Condition = SYNCHRONIZED,
        out: str | PathLike[str] | None = None,
        **chosen: Any,
    ) -> Any:
        return run(options, condition=condition, out=out, **chosen)

    described_options = (f"    {option.field}: {option.settings['help']}" for option in described(method))
    bound.__name__ = bound.__qualname__ = method.name
    bound.__doc__ = "\n".join(
        (method.help, "", f"Options by name, as of {method.__name__}:", *described_options)
    )
    return bound


def _make(kind: type[M], out: str | PathLike[str] | None, run: Callable[[Path], Any]) -> M:
    with ExitStack() as undone, silence():
        if out is not None:
            return kind(run(Path(out)), Path(out))
        scratch = tempfile.mkdtemp(prefix="simulshot-")
        undone.callback(shutil.rmtree, scratch, ignore_errors=True)
        made = kind(run(Path(scratch, "made")), Path(scratch, "made"))
        weakref.finalize(made, undone.pop_all().close)
        return made
