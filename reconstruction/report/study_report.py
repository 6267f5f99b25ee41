"""How a study describes itself in a report: its names, measures, sentences and section of the page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from capture_app.common.plugins import load_plugins
from capture_app.common.text import count
from reconstruction.report import wording
from reconstruction.scores.comparison_results import CompareResult
from reconstruction.scores.study_result import StudyResult

GROUP = "simulshot.studies"
WITHIN = "Measured correctly"
COVERAGE = "Given a distance"
EPIPOLAR = "Vertical mismatch"
STILL_COVERAGE = "At rest: given a distance"
POINTS = "Points in space"


@dataclass(frozen=True)
class MeasureText:
    """A row of a table: the measure without its `mover_` or `static_`, its name, explanation and unit.

    The explanation may contain the study's `placeholders` in braces.
    """

    key: str
    name: str
    text: str
    unit: str = wording.SHARE


@dataclass(frozen=True)
class Claim:
    """A study's main result for the first screen: one value per condition, and what it is a value of."""

    values: tuple[float, float]
    what: str
    unit: str = wording.SHARE
    note: str = ""


CORRECT = (
    MeasureText(
        "within_2pct",
        WITHIN,
        "Share whose distance is within 2 % of the truth; holes count as wrong. More is better.",
    ),
    MeasureText("within_1pct", "The same, more strictly", "Within 1 % of the truth."),
    MeasureText("within_5pct", "The same, less strictly", "Within 5 % of the truth."),
)
"""Rows of every study of depth."""


@dataclass(frozen=True, kw_only=True)
class StudyText:
    """What a study is called, where it stands on the page, and what is measured.

    Its caption, engine, details and measures' explanations may contain `placeholders` in braces.
    """

    name: str
    """The name of its plugin."""
    subject: str
    """What it measures, for messages: `depth from all cameras`."""
    place: int = 100
    """Its position among the studies."""
    term: str = ""
    """Its entry under "How it was made"; none if empty."""
    caption: str = "{subject}, {cameras}"
    """The caption of its table."""
    measures: Sequence[MeasureText] = ()
    control: bool = True
    """Whether its measures are taken on moving things (`mover_`) and on the control (`static_`)."""
    condition_columns: Sequence[tuple[str, str]] = ()
    """Whole names of measures that the table of all conditions shows, and their column heads."""
    instant_columns: Sequence[tuple[str, str]] = ()
    """The same for the table of every instant."""
    engine: str = ""
    """The sentence that says what computed it."""
    details: str = ""
    """A detail of how it was made, after its cameras and instants."""
    missing: str = ""
    """Sentence for a study that was skipped; its reason follows."""
    note: str = ""
    """Text below its table."""
    hero: str = ""
    """Key of its picture that may open the page."""
    why: str = ""
    """Template: why the instant matters for it. The first study that was made and has one is shown."""
    diagram: str = ""
    """File of the report's templates that is drawn beside `why`."""
    section: str = ""
    """Template of a section of its own, which reads `view`; without one, its table is among the others."""
    title: str = ""
    """The section's title."""
    section_place: int = 70
    """Position of its section: the pictures are at 10, the tolerated delay at 40, the measurements at 80."""
    scripts: Sequence[str] = ()
    """Scripts among the report's templates that its section needs."""
    replaces: str = ""
    """Name of a study; where that was made, this one adds nothing to the verdict."""

    def unit(self, measure: str) -> str:
        """Return the unit of a measure by its whole name."""
        return next(one.unit for one in self.measures if measure.endswith(one.key))


class StudyReport:
    """Everything that a page, a screen and the verdict say about one study; a study overrides what it has."""

    text: ClassVar[StudyText]

    @classmethod
    def placeholders(cls, found: StudyResult[Any]) -> dict[str, str]:
        """Values for the names in braces, in its caption, measures and engine."""
        return {
            "subject": cls.text.subject[0].upper() + cls.text.subject[1:],
            "names": " and ".join(found.cameras),
            "cameras": count(len(found.cameras), "camera"),
            "number": f"{len(found.cameras)}",
            "reference": found.cameras[0],
        }

    @classmethod
    def verdict(cls, result: CompareResult, found: StudyResult[Any]) -> str:
        """Return its sentence of the verdict; empty where the two conditions do not clearly differ."""
        return ""

    @classmethod
    def as_recorded(cls, found: StudyResult[Any]) -> str | None:
        """Return what it found in images that were not synchronized; None if it says nothing of these."""
        return None

    @classmethod
    def control_sentence(cls, result: CompareResult, found: StudyResult[Any]) -> str:
        """Return whether timing alone explains the difference, by what stands still."""
        return ""

    @classmethod
    def claim(cls, found: StudyResult[Any]) -> Claim | None:
        """Return its main result for the first screen."""
        return None

    @classmethod
    def view(cls, found: StudyResult[Any], heads: Mapping[str, str], out: Path) -> dict[str, Any]:
        """Return what its section reads besides the results; `heads` are the names of both conditions."""
        return {}

    @classmethod
    def files(cls, found: StudyResult[Any]) -> dict[str, Sequence[str]]:
        """Return its files beside the pictures, by what they are."""
        return {}


@cache
def study_reports() -> Mapping[str, type[StudyReport]]:
    """Return all installed studies by name, in their order; broken plugins are reported once and left out."""
    found = load_plugins(GROUP, "text", "placeholders").values()
    return {one.text.name: one for one in sorted(found, key=lambda one: (one.text.place, one.text.name))}


def reported(result: CompareResult) -> list[tuple[type[StudyReport], StudyResult[Any]]]:
    """Return the studies that were made, each with what it found."""
    return [(study_reports()[one.name], one) for one in result.studies if not one.skipped]
