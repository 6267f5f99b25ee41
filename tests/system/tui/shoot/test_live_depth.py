"""Live depth on the screen: instead of a preview, with its figures, until it is seen or wanted no longer."""

import shutil
from pathlib import Path

import pytest

from tests.project import JUMPER
from tests.unit.rig.test_live_depth import CAMERAS, calibrated_rig, show
from tests.unit.tui.driving import until
from tests.unit.tui.shoot.studio import Studio
from tests.waiting import SLOW_PATIENCE_S


async def test_l_shows_depth_of_the_chosen_camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    rig = calibrated_rig(tmp_path)
    studio = Studio(rig, tmp_path)
    async with studio.running(120, 40) as pilot:
        stage = studio.view.stage

        def shows(words: str) -> bool:
            show(rig, 2)
            return words in str(stage.border_title)

        assert shows("Live")
        await pilot.press("D")
        await until(pilot, lambda: shows("Live · depth is starting"))
        await until(pilot, lambda: shows("Live · the rig is not calibrated"), SLOW_PATIENCE_S)
        shutil.copytree(JUMPER, tmp_path / "sessions" / "jumper")
        await until(pilot, lambda: shows(" a second, "), SLOW_PATIENCE_S)
        await studio.settle(pilot)
        first, *others = (tile.picture.cells for tile in stage.grid.tiles[: len(CAMERAS)])
        reds = [cells.inks[..., 0].mean() / cells.inks[..., 1].mean() for cells in (first, *others)]
        assert reds[0] < 0.8 * min(reds[1:]), "its depth is blue and green, the others' previews are brown"
        await pilot.press("1", "2")
        await until(pilot, lambda: shows(" a second, "), SLOW_PATIENCE_S)
        await pilot.press("D")
        await until(pilot, lambda: shows("Live · 5 pictures within"))
        await pilot.press("D")
        await until(pilot, lambda: shows(" a second, "), SLOW_PATIENCE_S)
        rig.lose_link("it is gone")
        await until(pilot, lambda: shows("Live · 5 pictures within"))
