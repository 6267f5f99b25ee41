"""Rendering of templates: sentences, and pages, small HTML files with their styles, scripts and images."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, Template, select_autoescape

from capture_app.common.errors import BadInputError
from capture_app.common.text import count
from capture_app.session.files.durable import write_atomic
from reconstruction.common import wording
from reconstruction.common.outputs import METRICS, REPORT

PACKAGE, TEMPLATES = "reconstruction.pages", "template"
FILTERS = (
    count, wording.offset_text, wording.microseconds, wording.milliseconds, wording.number, wording.quantity,
    wording.seconds, wording.percentage, wording.percent, wording.keep_units, wording.timeliness,
    wording.walking_distance, wording.delays, wording.times, wording.late_or_early,
)  # fmt: skip


@dataclass(frozen=True)
class Section:
    """One section of a page: its template, and its anchor and title in the contents list.

    The template reads the page's view, and the section's own as `view`.
    """

    template: str | Template
    anchor: str = ""
    title: str = ""
    view: Mapping[str, object] | None = None


def as_template(source: str, package: str = PACKAGE) -> Template:
    """Compile a template given as text; it may include and import the report's templates."""
    return _environment(package).from_string(source)


def render_page(view: Mapping[str, object], sections: Sequence[Section], package: str = PACKAGE) -> str:
    """Render the page's frame around its sections, whose templates read `view`.

    The frame shows the view's `title`, `kicker`, `name` and `verdict`: a headline and the text after it.
    Optional keys: `opening`, the template below the headline; `kind`, a word for the images' origin;
    `numbers_in`, the files beside the page that hold its numbers; `scripts`, appended to the page's own; and
    `running`, what is not on the page yet: it loads itself again until there is nothing.
    Section templates are looked up in `package`, then in the report.
    """
    headline, lead = wording.headline(str(view["verdict"]))
    frame = {"opening": "", "kind": "", "numbers_in": (METRICS,), "scripts": (), "running": ()}
    shown = {**frame, **view, "headline": headline, "lead": lead, "sections": sections}
    return _environment(package).get_template("page.html").render(shown)


def render_sentences(template: str, package: str = PACKAGE, **view: object) -> str:
    """Render plain text on one line, from a template's file (.txt) or its text."""
    return re.sub(r"[ \n]+", " ", _text_template(template, package).render(view)).strip()


def render_lines(template: str, package: str = PACKAGE, **view: object) -> list[str]:
    """Render the lines of plain text that a command prints, from a template's file (.txt) or its text."""
    text = _text_template(template, package).render(view)
    return [line.rstrip() for line in text.splitlines() if line.strip()]


def _text_template(template: str, package: str) -> Template:
    environment = _environment(package, escapes=False)
    return (environment.get_template if template.endswith(".txt") else environment.from_string)(template)


def write_page(page: str, out: Path) -> Path:
    """Write `report.html` atomically into the folder `out` and return its path.

    Raises:
        BadInputError: the page cannot be written.
    """
    target = out / REPORT
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_atomic(target, page.encode("utf-8", "replace"))
    except OSError as error:
        raise BadInputError(
            f"cannot write the report {target}: {error.strerror or error}",
            hint="choose another folder with --out",
        ) from error
    return target


@cache
def _environment(package: str, *, escapes: bool = True) -> Environment:
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(name, TEMPLATES) for name in dict.fromkeys((package, PACKAGE))]),
        autoescape=select_autoescape((), ("txt",), default_for_string=escapes, default=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update({function.__name__: function for function in FILTERS})
    return environment
