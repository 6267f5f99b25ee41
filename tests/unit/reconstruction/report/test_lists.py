"""Lists of our pages hold terms or items alone, as screen readers count them."""

from html.parser import HTMLParser
from pathlib import Path

import pytest

from tests.project import ROOT

ALLOWED = {"dl": {"dt", "dd", "div", "script", "template"}, "ul": {"li"}, "ol": {"li"}}
EMPTY = {"br", "hr", "img", "input", "link", "meta", "source"}
PAGES = sorted(page for room in ("reconstruction", "capture_app") for page in (ROOT / room).rglob("*.html"))


class Lists(HTMLParser):
    """Collects children of lists that are none of theirs."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.strays: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        above = self.open[-1] if self.open else ""
        if above in ALLOWED and tag not in ALLOWED[above]:
            self.strays.append(f"{tag} in {above}, line {self.getpos()[0]}")
        if tag not in EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while tag in self.open and self.open.pop() != tag:
            pass


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_lists_have_their_own_children_alone(page: Path) -> None:
    lists = Lists()
    lists.feed(page.read_text())
    assert lists.strays == []
