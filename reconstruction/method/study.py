"""Base classes of a comparison's studies: context, needs, options, skipping, and pictures."""

import logging
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import msgspec

from capture_app.common.errors import BadInputError, NotAvailableError, SimulshotError
from capture_app.common.optional_packages import require_reconstruction
from capture_app.console.terminal import Progress
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import save_picture
from reconstruction.common.native_libraries import TRACEBACK, ForeignError, opencv_calls, unexpected_error
from reconstruction.common.options import Pair, checked, compare_keywords
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.interface import Method
from reconstruction.method.study_report import StudyReport
from reconstruction.method.study_result import Measure, Picture, StudyResult
from reconstruction.method.tally import CONDITIONS
from reconstruction.scene.conditions import ALL_APART, SYNCHRONIZED, Condition, FrameOffset
from reconstruction.scene.instant_choice import choose_moving_instants, pair_instants
from reconstruction.scene.pairs import PairChoice
from reconstruction.scene.scene import Scene

TIMING = "timing"
"""Pseudo-study for `needs`: the cameras' time offsets, measured after all pair studies."""
UNASKED = "it was not requested"
IMPOSSIBLE = (ValueError, ForeignError, NotAvailableError, BadInputError)
"""Errors for which one study is left out with its reason; a damaged file of true depth is such a one."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Context:
    """Shared, constant context of all studies of a comparison."""

    scene: Scene
    step: int = 1
    """Number of instants between images of which differences are motion."""
    offset: FrameOffset | None = None
    """Offset of a pair's second camera; None = no offset."""
    middle: int = 0
    """Instant from whose images cameras are chosen."""
    max_instants: int = 16
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of all studies, by their keywords."""
    studies: Sequence[str] = ()
    """Names of the studies asked for; empty = all."""
    folder: Path | None = None
    """Folder for pictures; None = no pictures."""
    progress: Progress = field(default_factory=lambda: Progress(0, silent=True))

    @property
    def compared(self) -> Scene:
        """The scene in which moves what moves between compared instants: both conditions are scored by it."""
        return self.scene.moving_over(self.step)


class Study(StudyReport, ABC):
    """One study of a comparison: what it needs, its options, how it is made, and how it is reported."""

    needs: ClassVar[Sequence[str]] = ()
    """Names of the studies whose results it reads, made or skipped, or `TIMING`.

    Independent studies run side by side, in threads.
    """
    needs_calibration: ClassVar[bool] = False
    min_cameras: ClassVar[int] = 1
    packages: ClassVar[Sequence[str]] = ()
    """Required packages of the extra `reconstruction`."""
    Options: ClassVar[type[msgspec.Struct]] = msgspec.Struct
    """Struct of the study's options; `common/options.py` defines how each is typed."""

    def __init__(self, context: Context) -> None:
        self.context, self.progress = context, context.progress
        self.scene, self.dataset = context.scene, context.scene.dataset
        self.compared, self.motion = context.compared, context.compared.motion
        keywords = compare_keywords(self.Options)
        chosen = {keywords[k]: value for k, value in context.options.items() if k in keywords}
        self.options: Any = checked(self.Options(**chosen))
        self.known = CompareResult()
        """Results available to the study when it runs: a first look at the session, and what it needs."""
        self.found = self.skipped(UNASKED, unasked=True)

    @property
    def steps(self) -> int:
        """Maximum number of progress lines that the study prints."""
        return 0

    def check(self) -> None:
        """Reject options that this session cannot satisfy, before anything is computed.

        Raises:
            SimulshotError: an option cannot be used.
        """

    def unasked(self) -> str:
        """Return why the study is not to be made, by its options and `known`; empty if it is."""
        return ""

    @abstractmethod
    def measure(self) -> StudyResult[Any]:
        """Make the study.

        Raises:
            ValueError: these cameras do not allow it.
            NotAvailableError: a package is not installed.
        """

    def run(self, known: CompareResult) -> StudyResult[Any]:
        """Make the study, or return a skipped result with the reason; a bug fails this study alone."""
        self.known = known
        why = self.unasked()
        self.found = self.skipped(why, unasked=True) if why else self._measured()
        return self.found

    def _measured(self) -> StudyResult[Any]:
        try:
            if self.needs_calibration and self.scene.problem:
                raise ValueError(self.scene.problem)
            if len(self.dataset.cameras) < self.min_cameras:
                raise ValueError(f"it needs {self.min_cameras} cameras")
            for package in self.packages:
                require_reconstruction(package, self.text.subject)
            with opencv_calls(self.text.subject):
                return self.measure()
        except IMPOSSIBLE as error:
            return self.skipped(str(error))
        except (SimulshotError, OSError):
            raise
        except Exception as error:
            if os.environ.get(TRACEBACK):
                raise
            failure = unexpected_error(error)
            _log.warning("%s failed: %s", self.text.subject, failure)
            return self.skipped(failure.what, failed=True)

    def skipped(self, why: str, *, unasked: bool = False, failed: bool = False) -> StudyResult[Any]:
        """Return a result without measures, with `why` as its reason."""
        return StudyResult(name=self.text.name, skipped=why, unasked=unasked, failed=failed)


class ConditionStudy(Study):
    """Study that measures any condition against the synchronized one, all else equal."""

    condition = ALL_APART
    """Default condition that is compared with the synchronized one."""

    @abstractmethod
    def prepare(self) -> None:
        """Compute everything that all conditions share, from images around the context's middle instant.

        Raises:
            ValueError: these cameras do not allow the measurement.
        """

    @abstractmethod
    def compare(self, condition: Condition, folder: Path | None = None) -> StudyResult[Any]:
        """Compare a condition with the synchronized one; write pictures if a folder is given.

        Raises:
            ValueError: the burst does not contain this condition.
            NotAvailableError: a package is not installed.
        """

    def adopt(self, ours: Self) -> None:
        """Adopt what both sessions must share from `ours`: the same study of the comparison's own session."""

    def measure(self) -> StudyResult[Any]:
        """Prepare the study and compare its default condition; see `Study.measure`."""
        self.prepare()
        return self.compare(self.condition, self.context.folder)

    def commands(self, method: Method, late: Condition) -> dict[str, str]:
        """Return the command lines that write the results of a method in both conditions."""
        timed = msgspec.structs.replace(method, time_shifts_ms=self.dataset.time_shifts_ms)
        session = self.dataset.session.folder
        return {
            side: timed.command_line(session, condition, side)
            for side, condition in zip(CONDITIONS, (SYNCHRONIZED, late), strict=True)
        }

    def compare_condition(self, condition: Condition) -> StudyResult[Any]:
        """Compare a further condition, or return a skipped result with the reason."""
        if condition == self.condition:
            return self.found
        self.progress = Progress(0, silent=True)
        try:
            with opencv_calls(self.text.subject):
                return self.compare(condition)
        except IMPOSSIBLE as error:
            return self.skipped(str(error))

    def compare_session(self, scene: Scene) -> StudyResult[Any]:
        """Compare with another session's synchronized images, not paired by instant.

        Returns a skipped result with the reason if that is impossible.
        """
        quiet = Progress(0, silent=True)
        context = replace(self.context, scene=scene, offset=None, folder=None, progress=quiet)
        twin = type(self)(replace(context, middle=len(scene.dataset.instants_ns) // 2))
        twin.condition = SYNCHRONIZED
        twin.adopt(self)
        found = twin.run(self.known)
        if found.skipped:
            return found
        names = dict.fromkeys(one.name for one in (*self.found.measures, *found.measures))
        measures = (Measure(name=n, synced=self.found.interval(n), offset=found.interval(n)) for n in names)
        return msgspec.structs.replace(found, measures=tuple(measures), per_instant=())


class PairStudy(ConditionStudy):
    """Study of two cameras with a delayed second one; its option `pair` names them."""

    needs_calibration = True
    min_cameras = 2
    measures_delay: ClassVar[bool] = False
    """Whether `compare_instants` measures depth, from which a tolerance curve is made."""
    reason = ""
    """Why these cameras were chosen."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        named = getattr(self.options, self.text.name, None)
        self.asked: Pair | None = getattr(self.options, "pair", named)
        """The requested cameras; None = chosen from the images."""

    @property
    def steps(self) -> int:
        """Number of progress lines: one for the choice of cameras, and one for each instant."""
        offset = self.context.offset
        return 1 + min(len(offset.pairs) if offset else 0, self.context.max_instants)

    def check(self) -> None:
        """Reject requested cameras that the session does not have; see `Study.check`."""
        self.scene.check_pair(self.asked)

    def adopt(self, ours: Self) -> None:
        """Use the pair of cameras that this study chose in the comparison's own session."""
        self.asked, self.reason = ours.cameras, ours.reason

    def compare_instants(
        self,
        pairs: Sequence[tuple[int, int]],
        condition: Condition,
        offsets_ms: dict[str, float],
        *,
        folder: Path | None = None,
    ) -> StudyResult[Any]:
        """Compare depth at `pairs` of instants: the first camera's, and the second's in the other condition.

        Raises:
            ValueError: the two views overlap too little.
        """
        raise NotImplementedError

    def late_condition(self, condition: Condition, offsets_ms: Mapping[str, float]) -> Condition:
        """Return the condition by the actual delay, or one in which the first camera keeps its image."""
        first, second = self.cameras
        if not offsets_ms:
            return condition.kept_at(first)
        late_ms = offsets_ms[second] - offsets_ms[first]
        return Condition(f"{second}={late_ms:g}ms", named_ms=((second, late_ms),))

    def use_pair(self, choice: PairChoice) -> None:
        """Use the chosen pair, with the second camera delayed by the context's offset.

        Raises:
            ValueError: no pair could be chosen.
        """
        if choice.cameras is None:
            raise ValueError(choice.why)
        self.cameras, self.reason = choice.cameras, self.reason or choice.why
        if offset := self.context.offset:
            self.condition = Condition(
                f"{offset.asked_ms:g}ms", named_ms=((self.cameras[1], offset.asked_ms),)
            )

    def instant_pairs(self, condition: Condition) -> tuple[list[tuple[int, int]], dict[str, float]]:
        """Return the instants of both cameras at which something moves, and each camera's delay, ms.

        The delays are empty if both cameras show one instant, or if the delay is drawn at each instant.

        Raises:
            ValueError: the burst does not contain the condition.
        """
        first, second = self.cameras
        if condition == SYNCHRONIZED:
            if not (found := [(k, k) for k in self.dataset.instants(first, second)]):
                raise ValueError(f"{self.dataset.name} has no images of {first} and {second} of one instant")
            late_ms = None
        else:
            found, late_ms = pair_instants(self.dataset, condition, first, second)
        nows = choose_moving_instants(self.motion, self.cameras, list(dict(found)), self.context.max_instants)
        pairs = [pair for pair in found if pair[0] in nows]
        return pairs, {} if late_ms is None else {first: 0.0, second: late_ms}


def write_pictures(
    drawn: Mapping[str, Mapping[str, Array]], texts: Sequence[Picture], out: Path, *, flat: str = ""
) -> tuple[Picture, ...]:
    """Write pictures, drawn by condition and key, into out/pictures; return the texts with their paths.

    The picture with the key `flat` has flat colours with hard edges and is stored as PNG, others as JPEG.
    """
    suffixes = {one.key: "png" if one.key == flat else "jpg" for one in texts}
    paths = {
        key: {side: save_picture(out, f"{key}_{side}.{suffix}", drawn[side][key]) for side in CONDITIONS}
        for key, suffix in suffixes.items()
    }
    return tuple(msgspec.structs.replace(one, **paths[one.key]) for one in texts)
