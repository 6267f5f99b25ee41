"""The page: one HTML file, its pictures beside it."""

import re

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from capture_app.experiments.paper import wording
from capture_app.experiments.paper.report import PaperReport

PACKAGE = "capture_app.experiments.paper"


def prose(text: str) -> Markup:
    """Return a text of an experiment as HTML, its commands set as code."""
    return Markup(re.sub(r"`([^`]*)`", r"<code>\1</code>", str(escape(wording.in_print(text)))))  # noqa: S704


FILTERS = (
    wording.papers,
    wording.ours,
    wording.sign,
    wording.by_default,
    wording.set_ups,
    prose,
    wording.condition,
)


def render_page(report: PaperReport) -> str:
    """Return the page as HTML."""
    environment = Environment(
        loader=PackageLoader(PACKAGE, "template"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update({one.__name__: one for one in FILTERS})
    return environment.get_template("page.html").render(
        report=report,
        headlines=wording.headlines(report),
        columns=wording.HEAD[1:],
        title=wording.TITLE,
        lead=wording.LEAD,
        key=wording.KEY,
        applications_lead=wording.APPLICATIONS_LEAD,
        conditions=wording.CONDITIONS,
        measured=wording.measured(report),
    )
