"""An app on a fake rig, in the mode Shoot."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path

from textual.pilot import Pilot

from capture_app.protocol.messages import BurstRequest
from capture_app.tui.screen_settings import Settings
from capture_app.tui.shoot.shoot_view import ShootView
from tests.unit.tui.driving import make_app
from tests.unit.tui.fake_rig import FakeRig, make_node
from tests.unit.tui.takes import make_take


def ready_rig(cameras: int) -> FakeRig:
    rig = FakeRig()
    rig.nodes = tuple(make_node(f"cam{number:02d}") for number in range(cameras))
    return rig


def saves_into(folder: Path, *, cameras: int = 3) -> Callable[[BurstRequest], Awaitable[str]]:
    """What makes a real session of each burst, as a leader does; each is worse than the one before."""
    taken = 0

    async def take(request: BurstRequest) -> str:
        nonlocal taken
        taken += 1
        assert request.frames is not None
        session = make_take(
            folder,
            cameras=cameras,
            instants=request.frames,
            spread_ns=20_000 * taken,
            name=f"{request.name or 'burst'}-{taken:03d}",
            note=request.note,
        )
        return str(session.folder)

    return take


class Studio:
    """The app, and what it asked of its rig."""

    def __init__(self, rig: FakeRig, folder: Path, settings: Settings | None = None) -> None:
        self.rig = rig
        self.app = make_app(rig, settings=settings or Settings(), sessions=folder)

    @property
    def view(self) -> ShootView:
        return self.app.screen_stack[0].query_one(ShootView)

    @property
    def requests(self) -> list[BurstRequest]:
        return [asked[1] for asked in self.rig.asked if isinstance(asked[1], BurstRequest)]

    @property
    def wishes(self) -> list[tuple[object, ...]]:
        return [asked[1:] for asked in self.rig.asked if asked[0] == "want_previews"]

    @asynccontextmanager
    async def running(
        self, width: int = 80, height: int = 24, *, notifications: bool = False
    ) -> AsyncIterator[Pilot[None]]:
        """Run the app in the mode Shoot, and give its pilot."""
        async with self.app.run_test(size=(width, height), notifications=notifications) as pilot:
            await self.enter(pilot)
            yield pilot

    async def enter(self, pilot: Pilot[None]) -> None:
        await pilot.press("2")
        await self.settle(pilot)

    async def settle(self, pilot: Pilot[None]) -> None:
        """Let messages come through, and what is done in threads be done."""
        quiet = 0
        while quiet < 4:
            await pilot.pause()
            brief = {"judging", "trash", "thumbs", "previews", "default", "measuring", "drawing"}
            workers = [worker for worker in self.app.workers if worker.group in brief]
            if workers:
                # One that a later one has cancelled is over, too.
                await asyncio.gather(*(worker.wait() for worker in workers), return_exceptions=True)
            quiet = 0 if workers else quiet + 1
