"""A report as a browser would see it."""

from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path

from reconstruction.report import wording

VOID = {"meta", "link", "img", "input", "br", "circle", "path", "rect"}


@dataclass
class Page(HTMLParser):
    """What a browser would see: elements with their attributes, text, and whether they nest."""

    elements: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    text: str = ""
    stack: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path) -> "Page":
        page = cls()
        HTMLParser.__init__(page)
        page.feed(path.read_text("utf-8"))
        page.close()
        assert page.stack == []
        return page

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, {key: value or "" for key, value in attrs}))
        if tag not in VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, {key: value or "" for key, value in attrs}))

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.stack.pop() == tag

    def handle_data(self, data):
        if not {"script", "style"} & set(self.stack):
            self.text += data.replace(wording.GAP, " ").replace("\n", " ")

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]
