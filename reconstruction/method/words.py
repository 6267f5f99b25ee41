"""Words of a score: its names, measures and section of the page, read from files beside its code."""

import tomllib
from collections.abc import Sequence
from importlib.resources import files

import msgspec
from msgspec import Struct

from capture_app.common.errors import BadInputError
from reconstruction.common import wording
from reconstruction.method.study_result import Picture

WORDS = "words.toml"
TEMPLATES = {
    "section": "section.html",
    "why": "why.html",
    "verdict": "verdict.txt",
    "as_recorded": "as_recorded.txt",
    "control_sentence": "control.txt",
}
"""Files of words beside a method's code, by the field of `StudyText` that holds them."""


class MeasureText(Struct, frozen=True, forbid_unknown_fields=True):
    """A table row: the measure without its `mover_` or `static_` prefix, its name, explanation and unit.

    The explanation may contain the study's `placeholders` in braces.
    """

    key: str
    name: str
    text: str
    unit: str = wording.PERCENT


class Claim(Struct, frozen=True, forbid_unknown_fields=True):
    """A measure that may be a study's main result on the first screen, and what it says in words."""

    measure: str
    what: str
    unit: str = wording.PERCENT
    note: str = ""


class StudyText(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A study's names, its position on the page, and its measures.

    The caption, engine, details and explanations of measures may contain `placeholders` in braces.
    """

    name: str
    """Name of the study's plugin."""
    subject: str
    """Subject of the study for messages: `depth from all cameras`."""
    place: int = 100
    """Position of the study among all studies."""
    term: str = ""
    """Term of the study under "How it was made"; empty for no entry."""
    caption: str = "{subject}, {cameras}"
    """Caption of the study's table."""
    measures: Sequence[MeasureText] = ()
    claims: Sequence[Claim] = ()
    """Candidates for the first screen; the first that both conditions have is shown."""
    pictures: Sequence[Picture] = ()
    """Its pictures, without their files; captions may contain words in braces that the score knows."""
    control: bool = True
    """Whether the measures are taken both on moving things (`mover_`) and on the control (`static_`)."""
    condition_columns: Sequence[tuple[str, str]] = ()
    """Full names of the measures in the table of all conditions, with their column heads."""
    instant_columns: Sequence[tuple[str, str]] = ()
    """Measures in the table of every instant, with their column heads."""
    engine: str = ""
    """Sentence that names the method that computed it."""
    details: str = ""
    """Detail of how it was made, shown after its cameras and instants."""
    missing: str = ""
    """Sentence for a skipped study; the reason follows."""
    note: str = ""
    """Text below the study's table."""
    hero: str = ""
    """Key of the study's picture that may open the page."""
    why: str = ""
    """Template that explains why the instant matters; the page shows the first available one."""
    diagram: str = ""
    """Template file of the drawing beside `why`."""
    section: str = ""
    """Template of the study's own section, which reads `view`; if empty, its table is listed with the others.
    """
    title: str = ""
    """Title of the section."""
    section_place: int = 70
    """Position of the section: the pictures are at 10, the tolerated delay at 40, the measurements at 80."""
    scripts: Sequence[str] = ()
    """Template files of the scripts that the section needs."""
    verdict: str = ""
    """Template of its sentence of the verdict, empty where the conditions do not clearly differ.

    It reads `found`, the whole `result`, whether the images are `together` in time, and the delays in words:
    `late` of a pair, `each_delayed` of all cameras. From `clear_fraction` on, a loss is clear.
    """
    as_recorded: str = ""
    """The same of images that were not synchronized; if there is none, the verdict is said of them too."""
    control_sentence: str = ""
    """The same on whether the control shows that timing alone made the difference."""
    replaces: str = ""
    """Name of a study that this one replaces in the verdict: if made, it adds no sentence."""

    def unit(self, measure: str) -> str:
        """Return the unit of a measure by its full name."""
        return next(text.unit for text in self.measures if measure.endswith(text.key))


def read_words(package: str) -> StudyText:
    """Read the words of a method from `WORDS` in its package, and those of `TEMPLATES` that are there.

    Raises:
        BadInputError: `WORDS` is not TOML, or has a key that does not exist.
    """
    folder = files(package)
    try:
        words = tomllib.loads((folder / WORDS).read_text("utf-8"))
        for name, file in TEMPLATES.items():
            if (template := folder / file).is_file():
                words[name] = template.read_text("utf-8")
        return msgspec.convert(words, StudyText)
    except (tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise BadInputError(f"{folder / WORDS}: {error}", hint="correct that file") from error
