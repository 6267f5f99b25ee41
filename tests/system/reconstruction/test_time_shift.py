"""Corrected times pair a camera's images anew."""

import json
from pathlib import Path
from typing import Any

import pytest

from capture_app.session.reading.reader import Session
from reconstruction.methods.batch.batch_plan import BatchPlan, compute_depth
from tests.unit.reconstruction.conftest import Reconstruct
from tests.unit.reconstruction.test_time_shift import (
    FRAME_MS,
    late,  # noqa: F401 - a fixture
)


def test_every_step_by_itself_pairs_the_images_that_belong_together(
    late: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    def both(command: str, *options: object) -> Any:
        """Without the shift and with it."""
        asked = (command, late.folder, "--instant", 2, *options, "--json", "--out")
        shift = ("--time-shift-ms", f"right={FRAME_MS}")
        mended = reconstruct(*asked, tmp_path / f"{command} mended", *shift).result
        assert mended["time_shifts_ms"] == {"right": FRAME_MS}
        return reconstruct(*asked, tmp_path / command).result, mended

    found, mended = both("stereo")
    assert mended["within_2pct"] > found["within_2pct"] + 0.05
    found, mended = both("panorama")
    # The board's parallax against the wall remains: a baseline of 0.2 at 2.2 and at 4, by 300 px.
    assert mended["synced"]["mover_misfit"]["median_px"] == pytest.approx(12.3, abs=0.5)
    assert found["synced"]["mover_misfit"]["median_px"] > 13
    found, mended = both("multiview", "--no-mesh")
    assert found["mover_within_2pct"] < 0.1
    assert mended["mover_within_2pct"] > 0.8
    (unit,), _ = BatchPlan(instants=(2,), time_shifts_ms={"right": FRAME_MS}).units(late.folder)
    folder = tmp_path / "unit"
    folder.mkdir()
    compute_depth(unit, folder)
    made = json.loads((folder / "unit.json").read_text())
    assert made["mover_within_2pct"] == mended["mover_within_2pct"]
