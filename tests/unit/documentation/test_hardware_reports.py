"""The page of cameras shows the reports that users file, as `doctor --report` writes them."""

import runpy

from tests.project import ROOT

REPORTS = runpy.run_path(str(ROOT / "docs" / "hardware_reports.py"))


def test_the_page_shows_all_reports() -> None:
    assert REPORTS["table"]() in (ROOT / "docs" / "hardware.md").read_text(encoding="utf-8")
