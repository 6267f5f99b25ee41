"""Splats in a comparison: what a camera that was left out would see, in step and apart."""

from pathlib import Path

import pytest

from reconstruction import CompareOptions, open_session
from tests.project import JUMPER


def test_delays_spoil_the_splat_where_something_moves(tmp_path: Path) -> None:
    made = open_session(JUMPER).compare(CompareOptions(studies=("splat",)), out=tmp_path / "out")
    found = made.result.study("splat")
    assert found is not None
    assert found.facts.reference == "cam00"
    assert "cam00" not in found.facts.made_from
    values = {one.name: (one.synced.value, one.offset.value) for one in found.measures}
    assert values["mover_psnr"][0] > 20
    assert values["mover_psnr"][0] > values["mover_psnr"][1] + 6
    assert values["static_psnr"][0] == pytest.approx(values["static_psnr"][1], abs=1)
    assert "A splat of" in made.result.verdict
    page = (tmp_path / "out" / "report.html").read_text()
    assert "The moment as a splat" in page
