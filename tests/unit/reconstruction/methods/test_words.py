"""Words are files: what a method says and shows stands beside its code, not in it."""

import ast
import re
from pathlib import Path

import pytest

import reconstruction
from reconstruction.method.score import study_reports
from reconstruction.method.words import TEMPLATES, WORDS, read_words

ROOMS = [Path(reconstruction.__file__).parent / room for room in ("methods", "checks")]
TAG = re.compile(r"</[a-z]+>|<(p|div|section|table|dl|figure)\b")


def test_no_string_of_a_method_is_html() -> None:
    found = [
        f"{file}:{node.lineno}"
        for room in ROOMS
        for file in room.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and TAG.search(node.value)
    ]
    assert found == []


@pytest.mark.parametrize(
    "file",
    [path for room in ROOMS for path in sorted(room.glob(f"*/{WORDS}"))],
    ids=lambda path: path.parent.name,
)
def test_the_words_of_a_method_are_of_its_score(file: Path) -> None:
    words = read_words(f"reconstruction.{file.parents[1].name}.{file.parent.name}")
    assert study_reports()[words.name].text == words
    for field, name in TEMPLATES.items():
        assert bool(getattr(words, field)) == file.with_name(name).exists(), name
    keys = [one.key for one in words.measures]
    for measure, _ in (*words.condition_columns, *words.instant_columns):
        assert any(measure.endswith(key) for key in keys), measure
