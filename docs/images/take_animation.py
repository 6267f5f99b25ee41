"""Makes `docs/images/take.webp`: a take on the real screen, of simulated cameras, from the key to the wiggle.

python docs/images/take_animation.py
"""

import asyncio
import os
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from numpy.typing import NDArray
from screen_drawing import draw_screen

from capture_app.common.node_state import NodeState
from capture_app.console.terminal import talk
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.protocol.orders import AddSimulated
from capture_app.rig.rig_link import RigLink
from capture_app.tui.app import SimulshotApp
from capture_app.tui.screen_settings import Settings
from capture_app.tui.shoot.shoot_view import ShootView

OUT = Path(__file__).with_name("take.webp")
SIZE = COLUMNS, ROWS = 120, 40
CAMERAS = 5
READY_S = 400.0
PLAN = {"shoot.name": "jump", "shoot.frames": 5, "shoot.before": 2, "shoot.countdown_s": 3.0}


class Film:
    """Pictures of the screen and how long each is seen, in ms."""

    def __init__(self, app: SimulshotApp) -> None:
        self._app = app
        self.frames: list[NDArray[np.uint8]] = []
        self.durations: list[int] = []

    def shoot(self, duration_ms: int) -> None:
        """Take the screen as it is; the same as before is seen longer."""
        frame = cv2.cvtColor(draw_screen(self._app.export_screenshot(), COLUMNS, ROWS), cv2.COLOR_RGB2BGR)
        if self.frames and np.array_equal(frame, self.frames[-1]):
            self.durations[-1] += duration_ms
        else:
            self.frames.append(np.asarray(frame, np.uint8))
            self.durations.append(duration_ms)

    async def roll(self, seconds: float, every_s: float = 0.25) -> None:
        """Take the screen again and again."""
        for _ in range(round(seconds / every_s)):
            await asyncio.sleep(every_s)
            self.shoot(round(every_s * 1000))

    def save(self, path: Path) -> None:
        """Write it as animated WebP."""
        animation = cv2.Animation()
        animation.frames, animation.durations, animation.loop_count = self.frames, self.durations, 0
        made, data = cv2.imencodeanimation(".webp", animation, [cv2.IMWRITE_WEBP_QUALITY, 85])
        assert made
        path.write_bytes(data.tobytes())
        talk(f"{path}: {len(self.frames)} pictures, {path.stat().st_size / 1e3:.0f} kB")


async def until(holds: Callable[[], bool], meanwhile: Callable[[], object] = lambda: None) -> None:
    """Wait."""
    async with asyncio.timeout(READY_S):
        while True:
            if holds():
                return
            await asyncio.sleep(0.7)
            meanwhile()


async def play(folder: Path) -> None:
    """Drive the screen as a photographer does."""
    async with await LeaderNode.start(
        LeaderOptions(sessions=folder, host="127.0.0.1", port=0, spool=folder / "spool")
    ) as leader:
        link = RigLink(leader.own_address)
        await link.order(AddSimulated(cameras=CAMERAS))
        app = SimulshotApp(link, settings=Settings(choices=PLAN), sessions=folder)
        async with app.run_test(size=SIZE):
            app.switch_mode("shoot")
            await asyncio.sleep(0.5)
            view = app.screen.query_one(ShootView)
            await until(lambda: [node.state for node in leader.status().nodes] == [NodeState.READY] * CAMERAS)
            await until(lambda: all(tile.picture.cells is not None for tile in view.stage.grid.tiles))
            film = Film(app)
            await film.roll(2.0, 0.5)
            app.simulate_key("space")
            await film.roll(3.5, 0.5)
            await until(lambda: view.stage.is_sheet, lambda: film.shoot(200))
            await film.roll(2.0, 0.5)
            for key in ("down", "right", "right"):
                app.simulate_key(key)
                await film.roll(0.5, 0.5)
            app.simulate_key("w")
            await film.roll(2.8, 1 / 6)
    film.save(OUT)


if __name__ == "__main__":
    with TemporaryDirectory(prefix="simulshot-film-") as made:
        os.environ |= dict.fromkeys(("XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME"), made)
        asyncio.run(play(Path(made)))
