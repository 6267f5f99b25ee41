"""What all studies of a comparison share: their protocol, their run, and the tally of both conditions."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Generic, Protocol, Self, TypeVar

import msgspec
from msgspec import Struct

from capture_app.errors import NotAvailableError
from capture_app.terminal import Progress
from reconstruction.calibration.rig import Rig
from reconstruction.scores.depth_results import MultiviewComparison, StereoComparison
from reconstruction.scores.panorama_results import PanoramaComparison
from reconstruction.scores.pose_results import PoseComparison
from reconstruction.scores.results import Interval
from reconstruction.scores.tally import Measurements, Tally, differences
from reconstruction.session.conditions import DISTINCT, SYNCED, Condition

SYNCHRONIZED, ALL_APART = Condition(SYNCED), Condition(DISTINCT)
SIDES = ("synced", "offset")

Result = TypeVar("Result", bound=StereoComparison | PanoramaComparison | MultiviewComparison | PoseComparison)
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


class StudyRun(Generic[Result]):
    """A study and its result, or the reason why it was skipped."""

    def __init__(self, study: Study[Result]) -> None:
        self.study = study
        self.result: Result | None = None
        self.skipped = "it was not asked for"

    def run_study(self, middle: int, progress: Progress, folder: Path) -> None:
        """Prepare the study and compare its own condition; pictures go into the folder."""
        try:
            self.study.prepare(middle, progress)
            self.result = self.study.compare(self.study.condition, progress, folder)
            self.skipped = ""
        except (ValueError, NotAvailableError) as error:
            self.skipped = str(error)

    def compare_condition(self, condition: Condition, skipped: list[str]) -> Result | None:
        """Compare a further condition; if it is impossible, the reason is added to `skipped`."""
        if self.result is None or condition == self.study.condition:
            return self.result
        try:
            return self.study.compare(condition, Progress(0, silent=True))
        except ValueError as error:
            skipped.append(f"{self.study.subject}: {error}")
            return None

    def compare_session(self, rig: Rig, skipped: list[str]) -> Result | None:
        """Compare with another session's synchronized pictures, not paired by instant; else as above."""
        if self.result is None:
            return None
        theirs = self.study.for_session(rig)
        quiet = Progress(0, silent=True)
        try:
            theirs.prepare(len(rig.dataset.instants_ns) // 2, quiet)
            found = theirs.compare(SYNCHRONIZED, quiet)
        except ValueError as error:
            skipped.append(f"{self.study.subject}: {error}")
            return None
        return msgspec.structs.replace(
            found, synced=self.result.synced, offset=found.synced, differences={}, per_instant=()
        )


class ComparisonTally(Generic[Form]):
    """Scores of both conditions, measured side by side on the same instants."""

    def __init__(self, form: type[Form], per_instant: Sequence[str]) -> None:
        """`per_instant` are the measures in every instant's own row, as `synced_*` and `offset_*`."""
        self._form = form
        self._measures = per_instant
        self._tallies = {side: Tally() for side in SIDES}
        self._rows: list[dict[str, float | int | None]] = []

    def add(self, measured: Mapping[str, Measurements], facts: Mapping[str, float | int | None]) -> None:
        """Add an instant, measured on both sides; its row begins with the facts."""
        row = dict(facts)
        for side, tally in self._tallies.items():
            tally.add(measured[side])
            row |= {f"{side}_{name}": Tally([measured[side]]).value(name) for name in self._measures}
        self._rows.append(row)

    @property
    def synced(self) -> Form:
        """Scores of the synchronized condition."""
        return self._tallies["synced"].scores(self._form)

    @property
    def offset(self) -> Form:
        """Scores of the other condition."""
        return self._tallies["offset"].scores(self._form)

    @property
    def per_instant(self) -> tuple[dict[str, float | int | None], ...]:
        """A row for each instant."""
        return tuple(self._rows)

    @property
    def differences(self) -> dict[str, Interval]:
        """Offset minus synchronized by measure, paired by instant."""
        return differences(self._tallies["synced"], self._tallies["offset"], self._form)
