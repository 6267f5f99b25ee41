"""What studies of a comparison share: how they are run and skipped, a pair of cameras, and their pictures."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Self

import msgspec

from capture_app.common.errors import NotAvailableError
from capture_app.console.terminal import Progress
from reconstruction.calibration.rig import Rig
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import save_picture
from reconstruction.common.native_libraries import ForeignError, opencv_calls
from reconstruction.pairs import PairChoice
from reconstruction.scores.study_result import Measure, Picture, StudyResult
from reconstruction.scores.tally import SIDES
from reconstruction.session.conditions import DISTINCT, SYNCED, Condition, FrameOffset
from reconstruction.session.instants import choose_moving_instants, pair_instants

SYNCHRONIZED, ALL_APART = Condition(SYNCED), Condition(DISTINCT)
FLAT_PICTURES = ("stereo_depth", "multiview_depth")
"""Flat colours with hard edges, kept as PNG; the others are JPEG."""
PANELS = {"stereo_pair": 2, "stereo_closeup": 2}
"""Panels side by side in a picture; the others have one."""

Pair = tuple[str, str]


class Study(ABC):
    """One kind of measurement, made synchronized and in another condition with all else equal."""

    name: ClassVar[str]
    """A key of `SUBJECTS`."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.dataset = rig.dataset
        self.motion = rig.motion
        self.condition = ALL_APART
        """What it compares with the synchronized condition if nothing else is asked for."""
        self.found = StudyResult(name=self.name, skipped="it was not asked for", unasked=True)

    @property
    @abstractmethod
    def steps(self) -> int:
        """How many progress lines preparing it and comparing its own condition take at most."""

    @abstractmethod
    def prepare(self, middle: int, progress: Progress) -> None:
        """Fix all that is the same in every condition, from pictures around the instant `middle`.

        Raises:
            ValueError: these cameras do not allow the measurement.
        """

    @abstractmethod
    def compare(self, condition: Condition, progress: Progress, folder: Path | None = None) -> StudyResult:
        """Compare a condition with the synchronized one, with pictures of it where there is a folder.

        Raises:
            ValueError: the burst does not hold this condition.
            NotAvailableError: it takes a library that is not installed here.
        """

    @abstractmethod
    def for_session(self, rig: Rig) -> Self:
        """This study of another session's cameras."""

    def run(self, middle: int, progress: Progress, folder: Path) -> None:
        """Prepare the study and compare its own condition; pictures go into the folder."""
        try:
            with opencv_calls(self.found.subject):
                self.prepare(middle, progress)
                self.found = self.compare(self.condition, progress, folder)
        except (ValueError, ForeignError, NotAvailableError) as error:
            self.skip(str(error))

    def skip(self, why: str, *, unasked: bool = False) -> None:
        """Measure nothing, for this reason."""
        self.found = StudyResult(name=self.name, skipped=why, unasked=unasked)

    def compare_condition(self, condition: Condition) -> StudyResult:
        """Compare a further condition, or say why that is impossible."""
        if condition == self.condition:
            return self.found
        try:
            with opencv_calls(self.found.subject):
                return self.compare(condition, Progress(0, silent=True))
        except (ValueError, ForeignError) as error:
            return StudyResult(name=self.name, skipped=str(error))

    def compare_session(self, rig: Rig) -> StudyResult:
        """Compare with another session's synchronized pictures, not paired by instant; else as above."""
        theirs = self.for_session(rig)
        quiet = Progress(0, silent=True)
        try:
            with opencv_calls(self.found.subject):
                theirs.prepare(len(rig.dataset.instants_ns) // 2, quiet)
                found = theirs.compare(SYNCHRONIZED, quiet)
        except (ValueError, ForeignError) as error:
            return StudyResult(name=self.name, skipped=str(error))
        ours = self.found
        names = dict.fromkeys(one.name for one in (*ours.measures, *found.measures))
        measures = tuple(Measure(name=n, synced=ours.interval(n), offset=found.interval(n)) for n in names)
        return msgspec.structs.replace(found, measures=measures, per_instant=())


class PairStudy(Study):
    """A study of two cameras whose second is late."""

    def __init__(self, rig: Rig, offset: FrameOffset | None, asked: Pair | None, max_instants: int) -> None:
        """`offset`: how late, None = not at all; `asked`: the cameras, None = chosen from the images."""
        super().__init__(rig)
        self.offset = offset
        self.asked = asked
        self.max_instants = max_instants
        self.cameras: Pair = ("", "")
        self.reason = ""

    @property
    def steps(self) -> int:
        """One for choosing the cameras, and one for each instant."""
        return 1 + min(len(self.offset.pairs) if self.offset else 0, self.max_instants)

    def for_session(self, rig: Rig) -> Self:
        """This pair of another session, synchronized."""
        theirs = type(self)(rig, None, self.cameras, self.max_instants)
        theirs.reason = self.reason
        return theirs

    def use_pair(self, choice: PairChoice) -> None:
        """Use the chosen pair, the second late by the offset that was asked for.

        Raises:
            ValueError: no pair could be chosen.
        """
        if choice.cameras is None:
            raise ValueError(choice.why)
        self.cameras, self.reason = choice.cameras, self.reason or choice.why
        if self.offset is not None:
            late = ((self.cameras[1], self.offset.asked_ms),)
            self.condition = Condition(f"{self.offset.asked_ms:g}ms", named_ms=late)

    def instant_pairs(self, condition: Condition) -> tuple[list[tuple[int, int]], dict[str, float]]:
        """The instants that the two cameras show, where something moves, and how late each camera is, ms.

        Empty for the latter where both are of one instant, or where every instant is drawn for itself.

        Raises:
            ValueError: the burst does not hold the condition.
        """
        first, second = self.cameras
        if condition == SYNCHRONIZED:
            found = [(k, k) for k in self.dataset.instants(first, second)]
            if not found:
                raise ValueError(f"{self.dataset.name} has no images of {first} and {second} of one instant")
            late_ms = None
        else:
            found, late_ms = pair_instants(self.dataset, condition, first, second)
        nows = [now for now, _ in found]
        chosen = set(choose_moving_instants(self.motion, self.cameras, nows, self.max_instants))
        offsets_ms = {} if late_ms is None else {first: 0.0, second: late_ms}
        return [pair for pair in found if pair[0] in chosen], offsets_ms


def write_pictures(
    drawn: Mapping[str, Mapping[str, Array]], texts: Mapping[str, tuple[str, str]], out: Path
) -> tuple[Picture, ...]:
    """Write pictures, drawn by side and key, into out/pictures; `texts` are titles and captions by key."""
    pictures = []
    for key, (title, caption) in texts.items():
        suffix = "png" if key in FLAT_PICTURES else "jpg"
        paths = {side: save_picture(out, f"{key}_{side}.{suffix}", drawn[side][key]) for side in SIDES}
        panels = PANELS.get(key, 1)
        pictures.append(Picture(key=key, title=title, caption=caption, panels=panels, **paths))
    return tuple(pictures)
