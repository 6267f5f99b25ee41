"""Score of a method, or of a check: results of two conditions in, measures, sentences and pictures out."""

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, ClassVar, Self, TypeVar

import msgspec

from capture_app.common.errors import DiskFullError, IncompleteError, SimulshotError
from capture_app.common.optional_packages import require_reconstruction
from capture_app.common.text import count
from capture_app.console.terminal import Progress
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import save_picture
from reconstruction.common.native_libraries import TRACEBACK, ForeignError, opencv_calls, unexpected_error
from reconstruction.common.options import Pair, checked, compare_keywords
from reconstruction.common.templates import render_sentences
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.interface import Method, scored
from reconstruction.method.phrases import EACH_DELAYED, LIMITS, late_text
from reconstruction.method.spoken import spoken
from reconstruction.method.study_result import Measure, Picture, StudyResult
from reconstruction.method.tally import CONDITIONS, Measurements, Tally
from reconstruction.method.words import StudyText
from reconstruction.scene.conditions import ALL_APART, SYNCHRONIZED, Condition, FrameOffset
from reconstruction.scene.instant_choice import (
    ShownInstant,
    choose_moving_instants,
    complete_instants,
    pair_instants,
    relative_offsets_ms,
)
from reconstruction.scene.pairs import PairChoice
from reconstruction.scene.scene import Scene

TIMING = "timing"
"""Pseudo-study for `needs`: the cameras' time offsets, measured after all pair studies."""
UNASKED = "it was not requested"
_log = logging.getLogger(__name__)
T = TypeVar("T")


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


class Score:
    """What a comparison makes of one method, or of a check that only compares: measures, words and pictures.

    A score of a method sets `text` and `Options`, its method, and overrides `measure_instant`. Others
    override `compare`, or `measure` if they compare nothing.
    """

    text: ClassVar[StudyText]
    needs: ClassVar[Sequence[str]] = ()
    """Names of the scores whose results it reads, made or skipped, or `TIMING`.

    Independent ones are made side by side, in threads.
    """
    needs_calibration: ClassVar[bool] = False
    min_cameras: ClassVar[int] = 1
    packages: ClassVar[Sequence[str]] = ()
    """Required packages of the extra `reconstruction`."""
    Options: ClassVar[type[msgspec.Struct]] = msgspec.Struct
    """The method that is scored, or another struct of options; `common/options.py` says how each is typed."""
    of_pair: ClassVar[bool] = False
    """Whether it is of two cameras, with a delayed second one; its option `pair` names them."""
    measures_delay: ClassVar[bool] = False
    """Whether `compare_instants` measures depth of a pair, from which a tolerance curve is made."""

    condition = ALL_APART
    """Default condition that is compared with the synchronized one."""
    cameras: tuple[str, ...] = ()
    """Cameras that are compared; the first keeps its own images."""
    reason = ""
    """Why these cameras were chosen."""

    def __init__(self, context: Context) -> None:
        self.context, self.progress = context, context.progress
        self.scene, self.dataset = context.scene, context.scene.dataset
        self.compared, self.motion = context.compared, context.compared.motion
        keywords = compare_keywords(self.Options)
        chosen = {keywords[k]: value for k, value in context.options.items() if k in keywords}
        self.options: Any = checked(self.Options(**chosen))
        self.known = CompareResult()
        """Results available when it is made: a first look at the session, and what it needs."""
        named = getattr(self.options, self.text.name, None)
        self.asked: Pair | None = getattr(self.options, "pair", named) if self.of_pair else None
        """The requested cameras of a pair; None = chosen from the images."""
        self.found = self.skipped(UNASKED, unasked=True)

    @classmethod
    def placeholders(cls, found: StudyResult[Any]) -> dict[str, str]:
        """Return the values that replace names in braces in the score's caption, measures and engine."""
        return {
            "subject": cls.text.subject[0].upper() + cls.text.subject[1:],
            "names": " and ".join(found.cameras),
            "cameras": count(len(found.cameras), "camera"),
            "number": f"{len(found.cameras)}",
            "reference": found.cameras[0],
        }

    @classmethod
    def verdict(cls, result: CompareResult, found: StudyResult[Any]) -> str:
        """Return the score's sentence of the verdict; empty if the conditions do not clearly differ."""
        return cls._said(cls.text.verdict, result, found)

    @classmethod
    def as_recorded(cls, result: CompareResult, found: StudyResult[Any]) -> str | None:
        """Return the score's sentence on images that were not synchronized; None if it has none."""
        return cls._said(cls.text.as_recorded, result, found) if cls.text.as_recorded else None

    @classmethod
    def control_sentence(cls, result: CompareResult, found: StudyResult[Any]) -> str:
        """Return a sentence on whether the control shows that timing alone made the difference, if known."""
        return cls._said(cls.text.control_sentence, result, found)

    @classmethod
    def _said(cls, template: str, result: CompareResult, found: StudyResult[Any]) -> str:
        view: dict[str, Any] = {
            "result": result,
            "found": found,
            "together": result.together(found.cameras),
            "late": late_text(result),
            "each_delayed": EACH_DELAYED,
        }
        return render_sentences(template, **view, **LIMITS)

    @classmethod
    def view(cls, found: StudyResult[Any], heads: Mapping[str, str], out: Path) -> dict[str, Any]:
        """Return the data that the score's section of the page shows besides the results.

        `heads` are both conditions with their column heads, `out` the report's folder.
        """
        return {}

    @classmethod
    def files(cls, found: StudyResult[Any]) -> dict[str, Sequence[str]]:
        """Return the score's files other than pictures, by their description."""
        return {}

    @property
    def pair(self) -> Pair:
        """The cameras of a pair."""
        first, second = self.cameras
        return first, second

    @property
    def steps(self) -> int:
        """Maximum number of progress lines that it prints."""
        offset = self.context.offset
        return 1 + min(len(offset.pairs) if offset else 0, self.context.max_instants) if self.of_pair else 0

    def check(self) -> None:
        """Reject options that this session cannot satisfy, before anything is computed.

        Raises:
            SimulshotError: an option cannot be used.
        """
        self.asked = self.scene.named_pair(self.asked)

    def unasked(self) -> str:
        """Return why it is not to be made, by its options and `known`; empty if it is."""
        return ""

    def run(self, known: CompareResult) -> StudyResult[Any]:
        """Make it, or return a skipped result with the reason; a bug fails this score alone."""
        self.known = known
        why = self.unasked()
        self.found = self.skipped(why, unasked=True) if why else self._guarded(self._measured)
        return self.found

    def _measured(self) -> StudyResult[Any]:
        if self.needs_calibration and self.scene.problem:
            raise ValueError(self.scene.problem)
        if len(self.dataset.cameras) < self.min_cameras:
            raise ValueError(f"it needs {self.min_cameras} cameras")
        for package in self.packages:
            require_reconstruction(package, self.text.subject)
        return self.measure()

    def _guarded(self, make: Callable[[], StudyResult[Any]]) -> StudyResult[Any]:
        """Return what is made, or a skipped result with the reason: what fails does not end a comparison."""
        try:
            with opencv_calls(self.text.subject):
                return make()
        except (ValueError, ForeignError) as error:
            return self.skipped(str(error))
        except (IncompleteError, DiskFullError, OSError):
            raise
        except SimulshotError as error:
            return self.skipped(str(error))
        except Exception as error:
            if os.environ.get(TRACEBACK):
                raise
            failure = unexpected_error(error)
            _log.warning("%s failed: %s", self.text.subject, failure)
            return self.skipped(failure.what, failed=True)

    def skipped(self, why: str, *, unasked: bool = False, failed: bool = False) -> StudyResult[Any]:
        """Return a result without measures, with `why` as its reason."""
        return StudyResult(name=self.text.name, skipped=why, unasked=unasked, failed=failed)

    def measure(self) -> StudyResult[Any]:
        """Prepare it and compare its default condition.

        Raises:
            ValueError: these cameras do not allow it.
            NotAvailableError: a package is not installed.
        """
        self.prepare()
        return self.compare(self.condition, self.context.folder)

    def prepare(self) -> None:
        """Choose what all conditions share, such as `cameras`; by default all that the session has.

        Raises:
            ValueError: these cameras do not allow the measurement.
        """
        self.cameras = self.dataset.cameras

    def compare(self, condition: Condition, folder: Path | None = None) -> StudyResult[Any]:
        """Compare a condition with the synchronized one; write pictures if a folder is given.

        Raises:
            ValueError: the burst does not contain this condition.
            NotAvailableError: a package is not installed.
        """
        first, late, tally = self.cameras[0], condition.kept_at(self.cameras[0]), Tally()
        complete = complete_instants(self.dataset, condition, first, self.cameras)
        moments = self.moving_moments(complete, (first,), self.context.max_instants)
        method = msgspec.structs.replace(self.options, instants=tuple(one.instant for one in moments))
        both = (method.run(self.scene, at) for at in (SYNCHRONIZED, late))
        for moment, *results in zip(moments, *both, strict=True):
            measured = {
                side: self.measure_instant(result, moment, side)
                for side, result in zip(CONDITIONS, results, strict=True)
            }
            tally.add(measured, {"instant": moment.instant, **moment.delays_ms(self.dataset)})
        return StudyResult(
            name=self.text.name,
            cameras=self.cameras,
            instants=tally.instants,
            offsets_ms=relative_offsets_ms(condition, self.dataset, first, self.cameras),
            commands=self.commands(method, late),
            measures=tally.measures,
            per_instant=tally.per_instant,
        )

    def moving_moments(
        self, moments: Sequence[ShownInstant], cameras: Sequence[str], limit: int
    ) -> list[ShownInstant]:
        """Return at most `limit` of these moments with motion; see `choose_moving_instants`."""
        by_instant = {moment.instant: moment for moment in moments}
        return [by_instant[k] for k in choose_moving_instants(self.motion, cameras, list(by_instant), limit)]

    def measure_instant(self, result: Any, one: ShownInstant, side: str) -> Measurements:
        """Return the measures of what the method yielded for an instant in a condition (`side`)."""
        raise NotImplementedError

    def commands(self, method: Method, late: Condition) -> dict[str, str]:
        """Return the command lines that write the results of a method in both conditions."""
        timed = msgspec.structs.replace(method, time_shifts_ms=self.dataset.time_shifts_ms)
        session = self.dataset.session.folder
        return {
            side: timed.command_line(session, condition, side)
            for side, condition in zip(CONDITIONS, (SYNCHRONIZED, late), strict=True)
        }

    @property
    def has_conditions(self) -> bool:
        """Whether it measures any condition, and not only shows the session."""
        return type(self).measure is Score.measure

    def adopt(self, ours: Self) -> None:
        """Adopt what both sessions must share from `ours`: the same score of the comparison's own session."""
        if self.of_pair:
            self.asked, self.reason = ours.pair, ours.reason

    def compare_condition(self, condition: Condition) -> StudyResult[Any]:
        """Compare a further condition, or return a skipped result with the reason."""
        if condition == self.condition:
            return self.found
        self.progress = Progress(0, silent=True)
        return self._guarded(lambda: self.compare(condition))

    def compare_session(self, scene: Scene) -> StudyResult[Any]:
        """Compare with another session's synchronized images, not paired by instant.

        Returns a skipped result with the reason if that is impossible.
        """
        quiet = Progress(0, silent=True)
        context = replace(self.context, scene=scene, offset=None, folder=None, progress=quiet)
        twin = type(self)(replace(context, middle=len(scene.dataset.instants_ns) // 2))
        twin.condition = SYNCHRONIZED
        twin.adopt(self)
        results = twin.run(self.known)
        if results.skipped:
            return results
        names = dict.fromkeys(measure.name for measure in (*self.found.measures, *results.measures))
        measures = (Measure(name=n, synced=self.found.interval(n), offset=results.interval(n)) for n in names)
        return msgspec.structs.replace(results, measures=tuple(measures), per_instant=())

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

    def write_pictures(
        self, drawn: Mapping[str, Mapping[str, Array]], out: Path, *, flat: str = "", **words: str
    ) -> tuple[Picture, ...]:
        """Write pictures, drawn by condition and key, into out/pictures; return their texts with their paths.

        The picture with the key `flat` has flat colours with hard edges and is stored as PNG, others as JPEG.
        `words` replace names in braces in the captions.
        """
        texts = [picture for picture in self.text.pictures if picture.key in drawn[CONDITIONS[0]]]
        suffixes = {text.key: "png" if text.key == flat else "jpg" for text in texts}
        paths = {
            key: {side: save_picture(out, f"{key}_{side}.{suffix}", drawn[side][key]) for side in CONDITIONS}
            for key, suffix in suffixes.items()
        }
        captions = {text.key: text.caption.format(**spoken(words, self.dataset.labels)) for text in texts}
        return tuple(
            msgspec.structs.replace(text, caption=captions[text.key], **paths[text.key]) for text in texts
        )

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


def say_all(result: CompareResult, say: Callable[[CompareResult], T]) -> T:
    """Return what `say` says of a result; a study whose words fail is in it by its failure only, logged."""
    result = spoken(result, result.labels)
    try:
        return say(result)
    except Exception as error:
        if isinstance(error, SimulshotError | OSError) or os.environ.get(TRACEBACK):
            raise
        studies = tuple(_sayable(found, result, say) for found in result.studies)
        if studies == result.studies:
            raise
        return say(msgspec.structs.replace(result, studies=studies))


def _sayable(
    found: StudyResult[Any], result: CompareResult, say: Callable[[CompareResult], object]
) -> StudyResult[Any]:
    """Return a study's result, or its failure if its words fail where it is alone."""
    try:
        say(msgspec.structs.replace(result, studies=(found,)))
    except Exception as error:
        if isinstance(error, SimulshotError | OSError):
            raise
        what = f"its words failed: {unexpected_error(error).what}"
        _log.warning("%s: %s", study_reports()[found.name].text.subject, what)
        return msgspec.structs.replace(found, skipped=what, failed=True)
    return found


@cache
def study_reports() -> Mapping[str, type[Score]]:
    """Return all installed scores by name, in their order."""
    kinds: list[type[Score]] = [resolve_name(kind.study) for kind in scored()]
    kinds.sort(key=lambda one: (one.text.place, one.text.name))
    return {score.text.name: score for score in kinds}


def reported(result: CompareResult) -> list[tuple[type[Score], StudyResult[Any]]]:
    """Return the studies that were made, each with its result."""
    return [(study_reports()[study.name], study) for study in result.studies if not study.skipped]
