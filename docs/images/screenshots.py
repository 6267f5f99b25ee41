"""Takes the pictures `docs/images/tui-*.svg` of the screen, from a real run with five simulated cameras.

`make pictures NAME=screenshots`; two minutes on two free cores. Nothing in them is drawn by hand: they
are what goes to a terminal, as SVG.
"""

import asyncio
import os
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from capture_app.common.node_state import NodeState
from capture_app.console.terminal import talk
from capture_app.protocol.orders import StopRig
from capture_app.rig.process import start_rig
from capture_app.rig.rig_link import RigLink, ask_status
from capture_app.tui.app import SimulshotApp
from capture_app.tui.rig.camera_screen import CameraScreen
from capture_app.tui.screen_settings import Settings
from capture_app.tui.shoot.shoot_view import ShootView

WIDE, SMALL = (120, 40), (80, 24)
CAMERAS = 5
TIMEOUT_S = 400.0


async def take_pictures(out: Path, folder: Path) -> None:
    """Run a rig and the screen on it, and take a picture of each mode."""
    rig = await start_rig(sessions=folder / "sessions", host="127.0.0.1", port=0)
    link = RigLink(rig.address)

    try:
        app = SimulshotApp(link, settings=Settings(), sessions=folder / "sessions")
        async with app.run_test(size=SMALL) as pilot:
            await asyncio.sleep(2)
            save(app, out / "tui-start.svg")
            await pilot.press("s")
            await pilot.resize_terminal(*WIDE)
            async with asyncio.timeout(TIMEOUT_S):
                while True:
                    nodes = (await ask_status(rig.address)).nodes
                    if [node.state for node in nodes] == [NodeState.READY] * CAMERAS:
                        break
                    await asyncio.sleep(0.5)
            await asyncio.sleep(8)
            save(app, out / "tui-rig.svg")
            await pilot.press("enter")
            await asyncio.sleep(6)
            save(app, out / "tui-camera.svg")
            await pilot.press("escape")
            await until(lambda: not isinstance(app.screen, CameraScreen))
            await pilot.press("2")
            view = app.screen.query_one(ShootView)
            await until(lambda: all(tile.picture.cells is not None for tile in view.stage.grid.tiles))
            save(app, out / "tui-shoot.svg")
            await pilot.press("space")
            await until(lambda: view.stage.is_sheet)
            await asyncio.sleep(20)
            save(app, out / "tui-take.svg")
            await pilot.press("3")
            await asyncio.sleep(5)
            save(app, out / "tui-sessions.svg")
    finally:
        await link.order(StopRig())


async def until(holds: Callable[[], bool]) -> None:
    """Wait."""
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            if holds():
                return
            await asyncio.sleep(0.5)


def save(app: SimulshotApp, path: Path) -> None:
    """Write what is on the screen."""
    path.write_text(app.export_screenshot(title="capture-app", simplify=True), encoding="utf-8")
    talk(f"{path}  {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    pictures = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    pictures.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix="simulshot-pictures-") as made:
        for variable in ("STATE", "CONFIG", "DATA", "CACHE"):
            os.environ[f"XDG_{variable}_HOME"] = str(Path(made) / variable.lower())
        os.environ.pop("NO_COLOR", None)
        asyncio.run(take_pictures(pictures, Path(made)))
