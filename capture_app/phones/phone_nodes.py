"""The nodes of phones: each phone that comes is a camera of the rig for as long as it is there."""

import asyncio
from collections.abc import Callable
from pathlib import Path

from capture_app.errors import SimulshotError
from capture_app.net.address import Address
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.camera.device_profiles import DeviceProfiles
from capture_app.phones import wire
from capture_app.phones.camera import PhoneCamera
from capture_app.phones.phone import Phone

AWAY_S = 60.0
"""A phone whose page is gone for so long leaves the rig; it comes back under its name."""
RETRY_S = 2.0
TELL_EVERY_S = 0.5


class PhoneNodes:
    """Runs a node for each phone, in this process."""

    def __init__(self, leaders: tuple[Address, ...], spool: Path, talk: Callable[[str], None]) -> None:
        """`leaders` are asked in turn; `talk` gets what a user may see."""
        self._leaders, self._spool, self._talk = leaders, spool, talk
        self._tasks: set[asyncio.Task[None]] = set()

    def add(self, phone: Phone) -> None:
        """Look after a phone from now on."""
        task = asyncio.create_task(self._look_after(phone))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def close(self) -> None:
        """End all nodes."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _look_after(self, phone: Phone) -> None:
        while True:
            await phone.came.wait()
            node = CameraNode(
                name=phone.name,
                open_camera=lambda: PhoneCamera(phone),
                leader=self._leaders[0],
                others=self._leaders[1:],
                talk=lambda line: self._talk(f"{phone.name}: {line}"),
                spool=self._spool,
                profiles=DeviceProfiles(),
            )
            tasks = [
                asyncio.create_task(node.run()),
                asyncio.create_task(_until_gone(phone)),
                asyncio.create_task(_tell_state(phone, node)),
            ]
            try:
                done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for task in tasks:
                    task.cancel()
                ended = await asyncio.gather(*tasks, return_exceptions=True)
            if tasks[0] in done and isinstance(ended[0], BaseException):
                if not isinstance(ended[0], SimulshotError):
                    raise ended[0]
                self._talk(f"{phone.name}: {ended[0]}")
                await phone.tell(wire.state_message(phone.name, "failed", str(ended[0]), phone.clock_words))
                await asyncio.sleep(RETRY_S)
            else:
                self._talk(f"{phone.name}: it has left")


async def _until_gone(phone: Phone) -> None:
    """Return when the phone's user has ended it, or nothing of it was seen for long."""
    while True:
        await phone.gone.wait()
        if phone.said_goodbye:
            return
        try:
            async with asyncio.timeout(AWAY_S):
                await phone.back.wait()
        except TimeoutError:
            return


async def _tell_state(phone: Phone, node: CameraNode) -> None:
    told = ""
    while True:
        await asyncio.sleep(TELL_EVERY_S)
        state, words = node.standing
        message = wire.state_message(phone.name, str(state or "joining"), words, phone.clock_words)
        if message != told or phone.take_wish_for_state():
            told = message
            await phone.tell(message)
