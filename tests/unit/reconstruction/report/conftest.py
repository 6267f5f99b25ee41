"""A comparison with pictures, and a report as a browser would see it."""

from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from reconstruction.common import wording
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.study_result import Picture, StudyResult
from reconstruction.report.comparison_report import write_report
from tests.unit.reconstruction.report.results import RESULT, whole_result, with_pictures, with_studies

VOID = {"meta", "link", "img", "input", "br", "circle", "path", "rect"}


class Page(HTMLParser):
    """What a browser would see: elements with their attributes, text, and whether they nest."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.text = ""
        self.stack: list[str] = []
        self.feed(path.read_text("utf-8"))
        self.close()
        assert self.stack == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {key: value or "" for key, value in attrs}))
        if tag not in VOID:
            self.stack.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.stack.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self.stack):
            self.text += data.replace(wording.GAP, " ").replace("\n", " ")

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]


ReadReport = Callable[..., Page]


@pytest.fixture
def read_report(tmp_path: Path) -> ReadReport:
    """Write the report of a result, with changes, into the test's folder and read it."""

    def read(result: CompareResult = RESULT, *studies: StudyResult[Any], **changes: Any) -> Page:
        changed = msgspec.structs.replace(with_studies(result, *studies), **changes)
        return Page(write_report(changed, tmp_path))

    return read


@pytest.fixture
def whole(tmp_path: Path) -> CompareResult:
    """A result with everything a report can show, its pictures in the test's folder."""
    return whole_result(tmp_path)


@pytest.fixture
def pictured(tmp_path: Path) -> CompareResult:
    """The result with three pictures on disk: ordinary, very wide and upright."""
    random = np.random.default_rng(1)
    (tmp_path / "pictures").mkdir()
    pictures = []
    for key, shape, suffix in (
        ("depth", (48, 64), "png"), ("pano", (40, 300), "jpg"), ("crop", (90, 30), "png")
    ):  # fmt: skip
        names = [f"pictures/{key}_{side}.{suffix}" for side in ("synced", "offset")]
        for name in names:
            assert cv2.imwrite(str(tmp_path / name), random.integers(0, 255, (*shape, 3), np.uint8))
        pictures.append(
            Picture(key=key, title=f'{key} "seen"', synced=names[0], offset=names[1], caption="a<b")
        )
    return with_pictures(RESULT, *pictures)
