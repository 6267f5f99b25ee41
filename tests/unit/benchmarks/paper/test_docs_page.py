"""The page of the documentation: all of the paper is on it, and its pictures are there."""

import re

import pytest

from benchmarks.paper import page
from benchmarks.paper.applications import APPLICATIONS, Showing
from benchmarks.paper.report import all_of_the_paper
from benchmarks.paper.values import FIGURES, PaperTable
from tests.project import ROOT

DOCS = ROOT / "docs"
PAGE = (DOCS / "paper.md").read_text()
SECTIONS = {part.partition("\n")[0]: part for part in re.split(r"^#{2,3} ", PAGE, flags=re.MULTILINE)}


@pytest.mark.parametrize("one", all_of_the_paper(), ids=lambda one: one.key)
def test_each_table_and_figure_has_the_papers_numbers_and_ours(one: PaperTable) -> None:
    section = SECTIONS[f"{one.place}: {one.title}"]
    for value in one.values:
        (row,) = (line for line in section.splitlines() if line.startswith(f"| {value.label} |"))
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        assert len(cells) == len(page.HEAD)
        if value.value is not None:
            assert f"{value.value:,.6g}" in cells[1]
    assert "Simulated: " in section
    assert re.search(r"\(\d+ trials?\)\.$", section, re.MULTILINE)
    assert (f"](images/paper-{one.key}" in section) == (one in FIGURES)


@pytest.mark.parametrize("showing", APPLICATIONS, ids=lambda showing: showing.application.key)
def test_each_application_has_its_command_and_its_numbers(showing: Showing) -> None:
    section = SECTIONS[f"{showing.application.place}: {showing.application.title}"]
    assert f"`{showing.application.command}`" in section
    for label, _ in showing.measures.values():
        assert f"| {label} |" in section
    assert "not run" not in section


def test_what_is_simulated_is_said_before_any_number() -> None:
    assert page.LEAD in PAGE.partition("|")[0]


def test_links_within_the_page_lead_to_its_headings() -> None:
    anchors = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in SECTIONS}
    linked = set(re.findall(r"\]\(#([^)]+)\)", PAGE))
    assert linked
    assert linked <= anchors


def test_its_pictures_are_few_and_small() -> None:
    pictures = re.findall(r"\]\((images/paper-[^)]+)\)", PAGE)
    assert sorted(pictures) == sorted(f"images/{path.name}" for path in (DOCS / "images").glob("paper-*"))
    assert sum((DOCS / picture).stat().st_size for picture in pictures) < 3_000_000
