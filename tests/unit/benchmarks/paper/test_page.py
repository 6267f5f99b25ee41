"""The paper's tables and figures: what a study may hand over, and the page made of it."""

from importlib import import_module
from pathlib import Path

import msgspec
import pytest

from benchmarks.paper import page
from benchmarks.paper import phase_paper as phase_part
from benchmarks.paper.__main__ import main
from benchmarks.paper.report import PARTS, PaperReport, all_of_the_paper, make_report
from benchmarks.paper.reproduction import Measured, Reproduction
from benchmarks.paper.trials import share_of
from benchmarks.paper.values import (
    FIGURE_5,
    INJECTIONS,
    RESTARTS,
    TABLE_2,
    TABLE_3,
)
from capture_app.common.errors import ExitCode


def test_a_number_of_the_paper_by_its_name() -> None:
    assert (TABLE_2["total.max"], TABLE_3["bias.least"]) == (121.0, 19.0)
    with pytest.raises(KeyError):
        TABLE_2["total.median"]


def test_names_and_keys_are_used_once() -> None:
    keys = [one.key for one in all_of_the_paper()]
    assert len(set(keys)) == len(keys) >= 11
    for one in all_of_the_paper():
        assert len(set(one.names)) == len(one.names) > 0
    measured = [key for keys in PARTS.values() for key in keys]
    assert len(set(measured)) == len(measured)
    assert set(measured) <= set(keys)


def test_a_name_that_the_paper_does_not_have_is_refused() -> None:
    ours = Measured({"total.mean": 20.0, "total.median": 15.0}, 5, "tolerance 20 us")
    with pytest.raises(ValueError, match=r"table-2 has no total\.median"):
        Reproduction(of=TABLE_2, protocol=ours, default=None, simulated="All.")


def test_a_figure_without_a_drawing_is_refused() -> None:
    ours = Measured({"apart": 60.0}, 5, "tolerance 20 us")
    with pytest.raises(ValueError, match="figure-5 is a figure"):
        Reproduction(of=FIGURE_5, protocol=ours, default=None, simulated="All.")


@pytest.mark.parametrize(("share", "trials"), [(1.0, 239), (0.1, 24), (0.001, 2)])
def test_a_share_of_the_trials(share: float, trials: int) -> None:
    assert share_of(239, share) == trials


def test_a_number_put_into_the_model_is_no_success() -> None:
    ours = Measured({"bias.mean": 372.0, "bias.least": 10.0, "difference.least": 30.0}, 1, "")
    one = Reproduction(of=TABLE_3, protocol=ours, default=None, simulated="All.", given=("bias.mean",))
    report = make_report({"table-3": one}, (), Path(), quick=False, seed=1)
    verdicts = {row.name: row.verdict for row in report.tables[0].rows}
    assert (verdicts["bias.mean"], verdicts["bias.least"]) == ("put in", "better")
    assert (verdicts["difference.least"], verdicts["messages"]) == ("", "")


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (None, "us", "–"),
        (3012.4, "us", "3,012 µs"),
        (0.97, "", "0.97"),
        (5.5, "", "5.50"),
        (28.7, "s", "28.7 s"),
    ],
)
def test_numbers_as_they_are_printed(value: float | None, unit: str, text: str) -> None:
    assert page.number(value, unit).replace("\N{NO-BREAK SPACE}", " ") == text


def test_a_folder_that_cannot_be_made_is_told_before_the_work(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    pytest.importorskip("matplotlib")
    (tmp_path / "file").write_text("")
    out = tmp_path / "file" / "page"
    assert main(["paper", "--out", str(out)]) == ExitCode.BAD_INPUT
    assert "choose another folder" in capsys.readouterr().err


def test_injections_and_restarts_at_the_papers_protocol() -> None:
    injections, restarts = phase_part.paper_part(share=0.01, seed=1)
    assert injections.protocol.values["moves.mean"] < INJECTIONS["moves.mean"]
    assert injections.protocol.values["all_s"] < INJECTIONS["all_s"]
    assert restarts.default is not None
    # The window is four times as wide.
    assert restarts.default.values["tries.mean"] < restarts.protocol.values["tries.mean"]
    assert 0.5 < restarts.protocol.values["each_s"] < RESTARTS["each_s"]


def test_every_table_and_figure_is_measured() -> None:
    measured = [key for keys in PARTS.values() for key in keys]
    assert sorted(measured) == sorted(one.key for one in all_of_the_paper())
    for module in PARTS:
        assert import_module(f"benchmarks.paper.{module}").paper_part


def test_the_command_prints_numbers_and_writes_the_page(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    pytest.importorskip("matplotlib")
    command = ["paper", "--out", str(tmp_path), "--quick", "--only", "table-1"]
    assert main(command) == ExitCode.OK
    printed = capsys.readouterr().out
    assert "Table I: a selfie stick, mean" in printed
    assert f"{tmp_path / 'paper.md'}" in printed
    assert main([*command, "--json"]) == ExitCode.OK
    report = msgspec.json.decode(capsys.readouterr().out, type=PaperReport)
    assert report == msgspec.json.decode((tmp_path / "paper.json").read_bytes(), type=PaperReport)
    assert [entry.key for entry in (*report.tables, *report.figures)] == ["table-1"]
    assert {row.paper for row in report.tables[0].rows} >= {103.0, 69.0, 123.0}
