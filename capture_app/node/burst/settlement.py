"""Settling on the instants of a burst by what its cameras tell, on disk before any of them hears of it."""

import asyncio
from collections.abc import Mapping
from contextlib import suppress

from capture_app.node.burst.camera_progress import CameraProgress
from capture_app.node.burst.instant_choice import InstantChoice, Reports
from capture_app.node.burst.plans import SharedPlan
from capture_app.session.format.burst_plan import CameraPlan


class Settlement:
    """The choice of one burst's instants, and the plan that it is kept in."""

    def __init__(
        self, choice: InstantChoice, plan: SharedPlan, cameras: Mapping[str, CameraProgress]
    ) -> None:
        self.choice = choice
        self._plan = plan
        self._cameras = cameras
        self._settling = asyncio.Lock()
        self._settled = asyncio.Event()
        if choice.is_settled:
            self._settled.set()

    @property
    def reports(self) -> Reports:
        """What each camera has told."""
        return {name: camera.report for name, camera in self._cameras.items()}

    @property
    def undecided(self) -> list[str]:
        """The cameras that keep the instants from being settled, once any camera has told what it has."""
        if self.choice.is_settled or not any(self.reports.values()):
            return []
        return [name for name, camera in self._cameras.items() if not camera.report and not camera.given_up]

    async def settle(self) -> None:
        """Settle on the instants if that is possible now. Raises DiskFullError; nothing is settled then."""
        async with self._settling:
            if self.choice.is_settled:
                return
            awaited = [camera.report for camera in self._cameras.values() if not camera.given_up]
            chosen = self.choice.find(awaited)
            if chosen is not None:
                await self._save(chosen)
                self.choice.chosen = chosen
                self._settled.set()

    async def save_plan(self) -> None:
        """Put on disk what the cameras have told. Raises DiskFullError."""
        await self._save(self.choice.wanted)

    async def wait(self, timeout_s: float) -> bool:
        """Wait until the instants are settled, at most so long; return whether they are."""
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                await self._settled.wait()
        return self.choice.is_settled

    async def _save(self, chosen: tuple[int, ...] | None) -> None:
        shares = [camera.report or CameraPlan(camera=camera.camera) for camera in self._cameras.values()]
        await self._plan.save(shares, chosen)
