"""Exposure, gain, white balance and focus as requested: stored with the rig, applied to joining cameras.

A camera that returns gets its own settings back. A new one gets the settings that all others have in common.
"""

import asyncio
from contextlib import suppress
from pathlib import Path

import msgspec
from msgspec import Struct

from capture_app.common.camera_facts import CameraControls, Control, ControlValue
from capture_app.common.errors import IncompleteError
from capture_app.common.text import UNREADABLE
from capture_app.node.leader.viewfinders import Viewfinders
from capture_app.protocol.log import Log
from capture_app.protocol.orders import ControlsAnswer, ControlsRequest
from capture_app.session.files.durable import write_atomic

SETTINGS = "_settings.json"


class Setting(Struct, frozen=True):
    """Value of one control of a camera, in its unit."""

    value: float
    unit: str


class CameraSettings:
    """Settings of one rig, in a file beside its sessions."""

    def __init__(self, sessions: Path, viewfinders: Viewfinders, log: Log) -> None:
        self._file, self._viewfinders, self._log = sessions / SETTINGS, viewfinders, log
        self._held: dict[str, dict[Control, Setting]] = {}
        self._writing = asyncio.Lock()
        with suppress(OSError, *UNREADABLE):
            self._held = msgspec.json.decode(self._file.read_bytes(), type=dict[str, dict[Control, Setting]])

    async def ask(self, request: ControlsRequest) -> ControlsAnswer:
        """Forward a request to its camera, and store the result. Raises IncompleteError, OSError."""
        answer = await self._viewfinders.ask(request, ControlsAnswer)
        held = dict(self._held.get(request.camera, {}))
        for control, asked in request.values.items():
            state = answer.state.state(control)
            held.pop(control, None)
            if state is not None and state.value is not None and not state.automatic:
                # Cameras round a requested value, each in its own way.
                held[control] = Setting(state.value if isinstance(asked, str) else asked, state.unit)
        if held != self._held.get(request.camera, {}):
            self._held[request.camera] = held
            self._file.parent.mkdir(parents=True, exist_ok=True)
            async with self._writing:
                await asyncio.to_thread(write_atomic, self._file, msgspec.json.encode(self._held))
        return answer

    async def give(self, camera: str) -> None:
        """Apply stored settings to a camera that has just joined; log once what it cannot do."""
        if not any(self._held.values()):
            return
        with suppress(IncompleteError, OSError):
            state = (await self._viewfinders.ask(ControlsRequest(camera=camera), ControlsAnswer)).state
            if values := self._values_to_set(camera, state):
                answer = await self.ask(ControlsRequest(camera=camera, values=values))
                for problem in dict.fromkeys(answer.state.problems.values()):
                    self._log.say(f"{self._log.title_of(camera)}: {problem}")

    def _values_to_set(self, camera: str, state: CameraControls) -> dict[Control, ControlValue]:
        values: dict[Control, ControlValue] = {}
        here = set(self._viewfinders.health) - {camera}
        for control in Control:
            own, mine = self._held.get(camera, {}).get(control), state.state(control)
            others = {
                settings[control]
                for name, settings in self._held.items()
                if name in here and control in settings
            }
            setting = own or (others.pop() if len(others) == 1 else None)
            if setting is not None and mine is None:
                said = f"its {control} cannot be controlled, as the other cameras' can"
                self._log.say(f"{self._log.title_of(camera)}: {said}")
            elif setting is not None and mine is not None and mine.unit == setting.unit:
                values[control] = setting.value
        return values
