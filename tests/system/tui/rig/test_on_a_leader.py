"""The mode Rig on a real leader, over its network: a first start to a camera in the list, and its end."""

from pathlib import Path

from capture_app.rig.rig_link import RigLink
from capture_app.tui.app import SimulshotApp
from capture_app.tui.rig.camera_screen import CameraScreen
from capture_app.tui.screen_settings import Settings
from tests.cheap_rig import start_leader
from tests.unit.tui.driving import text
from tests.waiting import SLOW_PATIENCE_S, until


async def test_from_the_first_screen_to_a_camera_and_its_end(tmp_path: Path) -> None:
    async with await start_leader(tmp_path / "sessions", spool=tmp_path / "spool") as leader:
        settings = Settings(choices={"start.cameras": 1, "start.scene": "bars"})
        app = SimulshotApp(
            RigLink(leader.own_address), settings=settings, sessions=tmp_path / "sessions", local=False
        )
        async with app.run_test(size=(80, 24)) as pilot:
            await until(lambda: "○ no camera" in text(app, "#header"))
            await pilot.press("s")
            await until(lambda: "cam00" in text(app, "#cameras-rows"))
            await until(lambda: "cam00 joined" in text(app, "#log Lines"))
            await pilot.press("enter")
            await until(lambda: isinstance(app.screen, CameraScreen))
            await until(lambda: "exchange" in str(app.screen.query_one("#camera-wedge").border_title))
            await pilot.press("escape")
            await pilot.press("delete", "k", "delete", "e")  # a camera that the leader runs: it is ended
            await until(
                lambda: not leader.status().nodes or "◌ lost" in text(app, "#cameras-rows"),
                seconds=SLOW_PATIENCE_S,
            )
            await until(lambda: not any(worker.group == "orders" for worker in app.workers))
            assert app.is_running
