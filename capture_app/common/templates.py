"""Templates of what is said, in files beside the code, and the lines of text that they give."""

from functools import cache
from typing import TYPE_CHECKING

from capture_app.common.text import count, duration

if TYPE_CHECKING:
    from jinja2 import Environment

FOLDER = "template"
"""Folder of a package's templates."""


def render_lines(template: str, package: str, **view: object) -> list[str]:
    """Render the lines of plain text that a command prints, from a template's file (.txt) in `package`."""
    return lines_of(environment_of(package).get_template(template).render(view))


def render_rows(template: str, package: str, **view: object) -> list[tuple[str, ...]]:
    """Render the rows of a table, each a line "NAME: TEXT" of a template, as `render_lines` does."""
    return [tuple(line.split(": ", 1)) for line in render_lines(template, package, **view)]


def lines_of(text: str) -> list[str]:
    """Return the lines of rendered text that are not blank."""
    return [line.rstrip() for line in text.split("\n") if line.strip()]


@cache
def environment_of(*packages: str, escapes: bool = False) -> "Environment":
    """Return an environment of templates that are looked up in these packages, in this order."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, select_autoescape

    environment = Environment(
        loader=ChoiceLoader([PackageLoader(name, FOLDER) for name in dict.fromkeys(packages)]),
        autoescape=select_autoescape((), ("txt",), default_for_string=escapes, default=True),
        undefined=StrictUndefined,
        extensions=["jinja2.ext.do"],
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(count=count, duration=duration)
    return environment
