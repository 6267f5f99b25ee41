"""Templates of what is said: sentences on one line, and the lines that a command prints."""

import re
from functools import cache
from typing import TYPE_CHECKING

from capture_app.common import templates
from reconstruction.common import wording

if TYPE_CHECKING:
    from jinja2 import Environment, Template

PACKAGE = "reconstruction.common"
FILTERS = (
    wording.offset_text, wording.microseconds, wording.milliseconds, wording.number, wording.quantity,
    wording.seconds, wording.percentage, wording.percent, wording.keep_units, wording.timeliness,
    wording.walking_distance, wording.delays, wording.times, wording.late_or_early,
)  # fmt: skip


def render_sentences(template: str, package: str = PACKAGE, **view: object) -> str:
    """Render plain text on one line, from a template's file (.txt) in `package` or its text."""
    return re.sub(r"[ \n]+", " ", _text_template(template, package).render(view)).strip()


def render_lines(template: str, package: str = PACKAGE, **view: object) -> list[str]:
    """Render the lines of plain text that a command prints, from a template as `render_sentences` does."""
    return templates.lines_of(_text_template(template, package).render(view))


@cache
def _text_template(template: str, package: str) -> "Template":
    environment = environment_of(package, PACKAGE, escapes=False)
    return (environment.get_template if template.endswith(".txt") else environment.from_string)(template)


@cache
def environment_of(*packages: str, escapes: bool = True) -> "Environment":
    """Return the environment of templates that are looked up in these packages, in this order."""
    environment = templates.environment_of(*packages, escapes=escapes)
    environment.filters.update({function.__name__: function for function in FILTERS})
    return environment
