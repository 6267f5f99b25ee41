"""What Space does while the rig is not ready, or cannot save; and what the line below says of a take."""

import asyncio
from pathlib import Path

from tests.unit.tui.shoot.studio import Studio, ready_rig, saves_into
from tests.unit.tui.shoot.test_course import line_of


async def test_on_the_sheet_a_take_is_seen_from_the_key_to_its_pictures(tmp_path: Path) -> None:
    rig = ready_rig(3)
    rig.take = saves_into(tmp_path)
    studio = Studio(rig, tmp_path)
    async with studio.running() as pilot:
        await pilot.press("space")
        await studio.settle(pilot)
        assert studio.view.stage.border_title == "burst-001"
        for number, keys in ((2, ("space",)), (3, ("r", "k"))):
            rig.saves = asyncio.Event()
            await pilot.press(*keys)
            await studio.settle(pilot)
            assert line_of(studio) == f"◔ burst-{number:03d}: taken; cameras are saving; x cancels"
            assert studio.view.stage.border_title == f"burst-{number - 1:03d}"
            rig.saves.set()
            await studio.settle(pilot)
            sheet = studio.view.stage.sheet.sheet
            assert sheet is not None
            assert sheet.session.name == f"burst-{number:03d}"
            assert studio.view.stage.border_title == f"burst-{number:03d}"
            assert f"{20 * number} µs" in line_of(studio), "its verdict"
        assert studio.view.take_panel.plain.startswith("burst-003\nretake of burst-002\n")
