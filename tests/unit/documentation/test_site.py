"""The documentation as a site: built strictly, with all pages, the commands and the names of Python."""

from pathlib import Path

import pytest

from tests.project import ROOT
from tests.unit.documentation.pages import PAGES

MOST_WORDS = 1500
REFERENCES = {"paper.md", "session-format.md", "accuracy-measurements.md"}


def test_every_page_has_its_place_on_the_site() -> None:
    told = (ROOT / "mkdocs.yml").read_text().split()
    assert [page.name for page in (ROOT / "docs").glob("*.md") if f"docs/{page.name}" not in told] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_page_but_a_reference_is_long(page: Path) -> None:
    assert page.name in REFERENCES or len(page.read_text().split()) <= MOST_WORDS
