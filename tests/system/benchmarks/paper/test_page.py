"""The paper's tables and figures: what a study may hand over, and the page made of it."""

from pathlib import Path

import msgspec
import pytest

from benchmarks.paper import five_phones, page
from benchmarks.paper import led_panel as panel_part
from benchmarks.paper.report import PaperReport
from benchmarks.paper.values import (
    TABLE_2,
    WORST_PAIR,
)


def test_the_page_has_the_papers_numbers_beside_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(page, "QUICK_SHARE", 0.005)
    keys = frozenset(("table-2", "figure-5"))
    report = page.run(tmp_path, quick=True, seed=1, markdown=tmp_path / "docs" / "them.md", only=keys)
    (table,), (figure,) = report.tables, report.figures
    assert (table.key, figure.key) == ("table-2", "figure-5")
    assert msgspec.json.decode((tmp_path / "paper.json").read_bytes(), type=PaperReport) == report
    plain = (tmp_path / "paper.md").read_text()
    markdown = (tmp_path / "docs" / "them.md").read_text()
    assert figure.files == ("figure-5.jpg",)
    assert (tmp_path / figure.files[0]).stat().st_size > 10_000
    assert (tmp_path / "docs" / "images" / "them-figure-5.jpg").exists()
    assert f"]({figure.files[0]})" in plain
    assert "](images/them-figure-5.jpg)" in markdown
    for text in (plain, markdown):
        for entry in (table, figure):
            assert entry.title in text
            assert entry.rows[0].label in text
    assert page.run(tmp_path, quick=True, seed=1, only=keys) == report


def test_five_phones_start_and_take_a_burst() -> None:
    pairs, start, burst = five_phones.paper_part(share=0.001, seed=1)
    for ours in (pairs.protocol, pairs.default):
        assert 0.0 < ours.values["pair.max"] < WORST_PAIR["pair.max"]
    assert start.protocol.values["five.max"] < 10.0
    assert start.default is not None
    assert start.default.values["five.mean"] <= start.default.values["ready.mean"]
    assert burst.protocol.values["missing"] <= 5.0
    assert burst.protocol.values["apart.max"] >= pairs.protocol.values["pair.max"]


def test_two_phones_at_the_papers_protocol() -> None:
    table, panel = panel_part.paper_part(share=0.001, seed=1)
    assert (table.protocol.trials, panel.given) == (1, ("tau", "exposure", "repeats"))
    values = table.protocol.values
    assert set(values) == set(TABLE_2.names)
    assert values["total.max"] < TABLE_2["total.max"]
    assert values["total.mean"] <= values["phase.mean"] + values["clock.mean"] + 10.0
    assert panel.protocol.values["apart"] == pytest.approx(values["total.mean"])
