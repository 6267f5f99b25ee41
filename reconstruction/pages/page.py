"""Rendering of pages: one HTML file with its styles, scripts and images, from templates of sections."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from jinja2 import Template

from capture_app.common.errors import BadInputError
from capture_app.session.files.durable import write_atomic
from reconstruction.common import wording
from reconstruction.common.outputs import METRICS, REPORT
from reconstruction.common.templates import environment_of

PACKAGE = "reconstruction.pages"


@dataclass(frozen=True)
class Section:
    """One section of a page: its template, and its anchor and title in the contents list.

    The template reads the page's view, and the section's own as `view`.
    """

    template: str | Template
    anchor: str = ""
    title: str = ""
    view: Mapping[str, object] | None = None


@cache
def as_template(source: str, package: str = PACKAGE) -> Template:
    """Compile a template given as text; it may include and import the report's templates."""
    return environment_of(package, PACKAGE).from_string(source)


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
    return environment_of(package, PACKAGE).get_template("page.html").render(shown)


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
