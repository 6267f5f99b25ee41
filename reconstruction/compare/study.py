"""What studies of a comparison share: protocol, pair of cameras, run, and tally of both conditions."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Generic, Protocol, Self, TypeVar

import msgspec
from msgspec import Struct

from capture_app.errors import NotAvailableError
from capture_app.terminal import Progress
from reconstruction.calibration.rig import Rig
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import save_picture
from reconstruction.common.native_libraries import ForeignError, opencv_calls
from reconstruction.pairs import PairChoice
from reconstruction.scores.study_result import (
    Interval,
    MultiviewComparison,
    PanoramaComparison,
    Picture,
    PoseComparison,
    StereoComparison,
    TriangulationComparison,
)
from reconstruction.scores.tally import Measurements, Tally, differences
from reconstruction.session.conditions import DISTINCT, SYNCED, Condition, FrameOffset
from reconstruction.session.instants import choose_moving_instants, pair_instants

SYNCHRONIZED, ALL_APART = Condition(SYNCED), Condition(DISTINCT)
SIDES = ("synced", "offset")
FLAT_PICTURES = ("stereo_depth", "multiview_depth")
"""Flat colours with hard edges, kept as PNG; the others are JPEG."""
PANELS = {"stereo_pair": 2, "stereo_closeup": 2}
"""Panels side by side in a picture; the others have one."""

Pair = tuple[str, str]

Result = TypeVar(
    "Result",
    bound=StereoComparison
    | PanoramaComparison
    | MultiviewComparison
    | TriangulationComparison
    | PoseComparison,
)
Result_co = TypeVar("Result_co", covariant=True)
Form = TypeVar("Form", bound=Struct)


class Study(Protocol[Result_co]):
    """One kind of measurement, made synchronized and in another condition with all else equal."""

    @property
    def subject(self) -> str:
        """What it measures, for messages."""
        ...

    @property
    def steps(self) -> int:
        """How many progress lines preparing it and comparing its own condition take at most."""
        ...

    @property
    def condition(self) -> Condition:
        """What it compares with the synchronized condition if nothing else is asked for."""
        ...

    def prepare(self, middle: int, progress: Progress) -> None:
        """Fix all that is the same in every condition, from pictures around the instant `middle`.

        Raises:
            ValueError: these cameras do not allow the measurement.
        """
        ...

    def compare(self, condition: Condition, progress: Progress, folder: Path | None = None) -> Result_co:
        """Compare a condition with the synchronized one, with pictures of it where there is a folder.

        Raises:
            ValueError: the burst does not hold this condition.
            NotAvailableError: it takes a library that is not installed here.
        """
        ...

    def for_session(self, rig: Rig) -> Self:
        """The same study of another session's cameras."""
        ...


class PairStudy:
    """A study of two cameras whose second is late."""

    def __init__(self, rig: Rig, offset: FrameOffset | None, asked: Pair | None, max_instants: int) -> None:
        """`offset`: how late, None = not at all; `asked`: the cameras, None = chosen from the images."""
        self.rig = rig
        self.dataset = rig.dataset
        self.motion = rig.motion
        self.offset = offset
        self.asked = asked
        self.max_instants = max_instants
        self.cameras: Pair = ("", "")
        self.reason = ""

    @property
    def steps(self) -> int:
        """One for choosing the cameras, and one for each instant."""
        return 1 + min(len(self.offset.pairs) if self.offset else 0, self.max_instants)

    @property
    def condition(self) -> Condition:
        """The second camera is late by the offset that was asked for."""
        if self.offset is None:
            return SYNCHRONIZED
        return Condition(f"{self.offset.asked_ms:g}ms", named_ms=((self.cameras[1], self.offset.asked_ms),))

    def for_session(self, rig: Rig) -> Self:
        """The same pair of another session, synchronized."""
        theirs = type(self)(rig, None, self.cameras, self.max_instants)
        theirs.reason = self.reason
        return theirs

    def use_pair(self, choice: PairChoice) -> None:
        """Use the chosen pair.

        Raises:
            ValueError: no pair could be chosen.
        """
        if choice.cameras is None:
            raise ValueError(choice.why)
        self.cameras, self.reason = choice.cameras, self.reason or choice.why

    def instant_pairs(self, condition: Condition) -> tuple[list[tuple[int, int]], float | None]:
        """The instants that the two cameras show, where something moves, and how late the second is, ms.

        None for the latter where both are of one instant, or where every instant is drawn for itself.

        Raises:
            ValueError: the burst does not hold the condition.
        """
        first, second = self.cameras
        if condition == SYNCHRONIZED:
            found = [(k, k) for k in self.dataset.instants(first, second)]
            if not found:
                raise ValueError(f"{self.dataset.name} has no images of {first} and {second} of one instant")
            return self._where_things_move(found), None
        found, late_ms = pair_instants(self.dataset, condition, first, second)
        return self._where_things_move(found), late_ms

    def _where_things_move(self, pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
        nows = [now for now, _ in pairs]
        chosen = set(choose_moving_instants(self.motion, self.cameras, nows, self.max_instants))
        return [pair for pair in pairs if pair[0] in chosen]


class StudyRun(Generic[Result]):
    """A study and its result, or the reason why it was skipped."""

    def __init__(self, study: Study[Result]) -> None:
        self.study = study
        self.result: Result | None = None
        self.skipped = "it was not asked for"

    def run_study(self, middle: int, progress: Progress, folder: Path) -> None:
        """Prepare the study and compare its own condition; pictures go into the folder."""
        try:
            with opencv_calls(self.study.subject):
                self.study.prepare(middle, progress)
                self.result = self.study.compare(self.study.condition, progress, folder)
            self.skipped = ""
        except (ValueError, ForeignError, NotAvailableError) as error:
            self.skipped = str(error)

    def compare_condition(self, condition: Condition, skipped: list[str]) -> Result | None:
        """Compare a further condition; if it is impossible, the reason is added to `skipped`."""
        if self.result is None or condition == self.study.condition:
            return self.result
        try:
            with opencv_calls(self.study.subject):
                return self.study.compare(condition, Progress(0, silent=True))
        except (ValueError, ForeignError) as error:
            skipped.append(f"{self.study.subject}: {error}")
            return None

    def compare_session(self, rig: Rig, skipped: list[str]) -> Result | None:
        """Compare with another session's synchronized pictures, not paired by instant; else as above."""
        if self.result is None:
            return None
        theirs = self.study.for_session(rig)
        quiet = Progress(0, silent=True)
        try:
            with opencv_calls(self.study.subject):
                theirs.prepare(len(rig.dataset.instants_ns) // 2, quiet)
                found = theirs.compare(SYNCHRONIZED, quiet)
        except (ValueError, ForeignError) as error:
            skipped.append(f"{self.study.subject}: {error}")
            return None
        return msgspec.structs.replace(
            found, synced=self.result.synced, offset=found.synced, differences={}, per_instant=()
        )


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


class ComparisonTally(Generic[Form]):
    """Scores of both conditions, measured side by side on the same instants."""

    def __init__(self, form: type[Form], per_instant: Sequence[str]) -> None:
        """`per_instant` are the measures in every instant's own row, as `synced_*` and `offset_*`."""
        self._form = form
        self._measures = per_instant
        self._tallies = {side: Tally() for side in SIDES}
        self.per_instant: tuple[dict[str, float | int | None], ...] = ()

    def add(self, measured: Mapping[str, Measurements], facts: Mapping[str, float | int | None]) -> None:
        """Add an instant, measured on both sides; its row begins with the facts."""
        row = dict(facts)
        for side, tally in self._tallies.items():
            tally.add(measured[side])
            row |= {f"{side}_{name}": Tally([measured[side]]).value(name) for name in self._measures}
        self.per_instant += (row,)

    @property
    def synced(self) -> Form:
        """Scores of the synchronized condition."""
        return self._tallies["synced"].scores(self._form)

    @property
    def offset(self) -> Form:
        """Scores of the other condition."""
        return self._tallies["offset"].scores(self._form)

    @property
    def differences(self) -> dict[str, Interval]:
        """Offset minus synchronized by measure, paired by instant."""
        return differences(self._tallies["synced"], self._tallies["offset"], self._form)
