"""The frame of every page: head, verdict, contents and footer around sections, all in one file."""

import re
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from string import Template

from reconstruction.report import wording

LONG_HEADLINE = 70
"""Characters from which a headline is set smaller."""
FEWEST_FOR_CONTENTS = 5
SAME_NUMBERS = "Every number on this page is also in <code>metrics.json</code> beside it."
_HEADING = re.compile(r'<h2 id="([\w-]+)">(.*?)</h2>')


def fill_page(
    *,
    title: str,
    kicker: str,
    name: str,
    verdict: str,
    sections: Sequence[str],
    claims: str = "",
    footer: str = SAME_NUMBERS,
) -> str:
    """The page; `claims`, `sections` and `footer` are HTML, the rest is text."""
    folder = files("reconstruction.report") / "template"
    headline, lead = wording.headline(verdict)
    return Template((folder / "page.html").read_text("utf-8")).substitute(
        title=escape(title),
        css=(folder / "page.css").read_text("utf-8"),
        script=(folder / "page.js").read_text("utf-8"),
        kicker=escape(kicker) + (f' <span aria-hidden="true">·</span> <b>{escape(name)}</b>' if name else ""),
        headline=escape(headline),
        size="long" if len(headline) > LONG_HEADLINE else "short",
        lead=f'<p class="lead">{escape(lead)}</p>' if lead else "",
        claims=claims,
        contents=_contents(sections),
        sections="\n".join(section for section in sections if section),
        footer=footer,
    )


def _contents(sections: Sequence[str]) -> str:
    """Links to the sections that have a heading, where there are many."""
    found = [heading for section in sections if (heading := _HEADING.search(section))]
    if len(found) < FEWEST_FOR_CONTENTS:
        return ""
    links = "".join(f'<li><a href="#{one[1]}">{one[2]}</a></li>' for one in found)
    return f'<nav aria-label="Contents"><ul class="contents">{links}</ul></nav>'
