"""Keeps the controls of a node's camera: sets what is asked for, again after a failure, and locks for bursts.

What a camera chooses by itself is locked while a burst is picked, so that its frames look alike. That is done
where its driver is seen to tell what it chooses: a control that reads the same for ever may tell nothing, and
to hold it would change the picture.
"""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress

from capture_app.camera_controls import CameraControls, Control, ControlState, ControlValue
from capture_app.cameras.base import Camera
from capture_app.errors import SimulshotError

REFUSALS = (SimulshotError, OSError)
"""What a camera may raise that is asked for its controls."""
LOOK_EVERY_S = 2.0
"""Between two looks at what the camera has chosen."""


class ControlKeeper:
    """One camera's."""

    def __init__(self, camera: Callable[[], Camera], after_change: Callable[[], None]) -> None:
        """`camera` returns the one that is open; `after_change` is called when it may expose otherwise."""
        self.latest: tuple[ControlState, ...] = ()
        """All controls, as they were when they were looked at last."""
        self._camera, self._after_change = camera, after_change
        self._busy = asyncio.Lock()
        self._wanted: dict[Control, float] = {}
        """What is held because somebody asked for it."""
        self._seen: dict[Control, float | None] = {}
        self._live: set[Control] = set()
        """Those whose driver tells what the camera chooses."""
        self._locked: set[Control] = set()
        self._in_burst = False
        self._burst_changed = asyncio.Event()

    def set_in_burst(self, in_burst: bool) -> None:
        """Note that frames of a burst are being picked, or none are any more."""
        if in_burst != self._in_burst:
            self._in_burst = in_burst
            self._burst_changed.set()

    async def run(self) -> None:
        """Look at what the camera chooses, and lock it for bursts, until cancelled; then it is as it was."""
        try:
            while True:
                with suppress(TimeoutError):
                    async with asyncio.timeout(LOOK_EVERY_S):
                        await self._burst_changed.wait()
                self._burst_changed.clear()
                with suppress(*REFUSALS):
                    async with self._busy:
                        await (self._lock() if self._in_burst else self._unlock())
        finally:
            # A camera may keep what it was told last, for other programs too.
            await self._let_go()

    async def read(self) -> CameraControls:
        """Return all controls as they stand."""
        async with self._busy:
            return CameraControls(controls=await self._look())

    async def apply(self, wanted: Mapping[Control, ControlValue]) -> CameraControls:
        """Set these controls as well as the camera can; return all as they stand then, and what it cannot."""
        problems: dict[Control, str] = {}
        async with self._busy:
            before = CameraControls(controls=await self._look())
            for control, value in wanted.items():
                state = before.state(control)
                if state is None:
                    problems[control] = f"it has no control of its {control}"
                    continue
                try:
                    if problem := await self._set(state, value):
                        problems[control] = problem
                except REFUSALS as error:
                    problems[control] = str(error)
            self._after_change()
            return CameraControls(controls=await self._look(), problems=problems)

    async def restore(self) -> None:
        """Set again what is held, and let go of what was locked: the camera was opened anew."""
        async with self._busy:
            await self._let_go()
            for control, value in self._wanted.items():
                with suppress(*REFUSALS):
                    await self._camera().set_control(control, value)
            if self._wanted:
                self._after_change()

    async def _look(self) -> tuple[ControlState, ...]:
        self.latest = ()
        # A camera that has failed is opened again by others, and none of its controls ends the node.
        with suppress(*REFUSALS):
            self.latest = await self._camera().controls()
        return self.latest

    async def _set(self, state: ControlState, value: ControlValue) -> str:
        """Set one; return what is not as it was asked for, empty where nothing is."""
        if value == "auto":
            return await self._release(state)
        control, asked = state.control, state.value if isinstance(value, str) else value
        if not state.can_be_set:
            return f"its {control} cannot be set"
        if asked is None:
            return f"it does not tell its {control}, which is not held"
        nearest = state.clamped(asked)
        await self._camera().set_control(control, nearest)
        self._wanted[control] = nearest
        self._locked.discard(control)
        if value == "hold" and state.automatic and control not in self._live:
            return f"it may not tell the {control} that it had chosen: look whether the picture has changed"
        if nearest != asked:
            return f"{asked:g} {state.unit} is out of its range, {state.least:g} to {state.most:g}"
        return ""

    async def _release(self, state: ControlState) -> str:
        if not state.can_be_automatic:
            return f"it does not choose its {state.control} itself"
        self._wanted.pop(state.control, None)
        self._locked.discard(state.control)
        await self._camera().set_control(state.control, None)
        return ""

    # What is locked for a burst is not told to the engine: an exposure that becomes known moves the moment of
    # light that stamps are taken for, and with it the grid, just when a burst is picked.

    async def _lock(self) -> None:
        for state in await self._look():
            if state.automatic and state.control in self._live and state.value is not None:
                self._locked.add(state.control)
                await self._camera().set_control(state.control, state.value)

    async def _unlock(self) -> None:
        await self._let_go()
        for state in await self._look():
            if state.automatic and state.control in self._seen and self._seen[state.control] != state.value:
                self._live.add(state.control)
            self._seen[state.control] = state.value

    async def _let_go(self) -> None:
        """Have the camera choose again what is locked; what it refuses stays locked, until the next time."""
        for control in tuple(self._locked):
            with suppress(*REFUSALS):
                await self._camera().set_control(control, None)
                self._locked.discard(control)
