"""Controls that were set on cameras of a rig, and which of them a camera gets that joins later."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest
from msgspec.structs import replace

from capture_app.common.camera_facts import TIMES, CameraControls, Control, ControlState
from capture_app.common.errors import IncompleteError
from capture_app.node.leader.camera_settings import CameraSettings
from capture_app.protocol.log import Log
from capture_app.protocol.orders import CameraHealth, ControlsAnswer, ControlsRequest
from tests.unit.node.camera.controlled_camera import EXPOSURE, GAIN


class Cameras:
    """Cameras with open streams; each has its controls, takes whole values, and notes what it is asked."""

    def __init__(self) -> None:
        self.states: dict[str, dict[Control, ControlState]] = {}
        self.set: list[tuple[str, Control, Any]] = []
        self.problems: dict[Control, str] = {}
        self.asked = 0

    def join(self, name: str, *states: ControlState) -> None:
        self.states[name] = {state.control: state for state in states or (EXPOSURE, GAIN)}

    @property
    def health(self) -> dict[str, CameraHealth]:
        return dict.fromkeys(self.states, CameraHealth())

    async def ask(self, request: ControlsRequest, _: type[ControlsAnswer]) -> ControlsAnswer:
        if request.camera not in self.states:
            raise IncompleteError(f"{request.camera} has no open stream")
        self.asked += 1
        states = self.states[request.camera]
        for control, value in request.values.items():
            self.set.append((request.camera, control, value))
            if isinstance(value, str):
                states[control] = replace(states[control], automatic=value == "auto")
            elif control in states:
                states[control] = replace(states[control], value=float(round(value)), automatic=False)
        problems = self.problems if request.values else {}
        answered = CameraControls(controls=tuple(states.values()), problems=problems)
        return ControlsAnswer(camera=request.camera, state=answered)


@pytest.fixture
def cameras() -> Cameras:
    return Cameras()


@pytest.fixture
def log() -> Log:
    return Log()


@pytest.fixture
def settings(tmp_path: Path, cameras: Cameras, log: Log) -> Callable[[], CameraSettings]:
    """The settings as a leader that has just been started reads them."""
    log.title_of = str.upper
    return lambda: CameraSettings(tmp_path / "sessions", cast(Any, cameras), log)


async def set_on(settings: CameraSettings, camera: str, values: dict[Control, Any]) -> None:
    await settings.ask(ControlsRequest(camera=camera, values=values))


async def test_a_camera_gets_its_own_settings_back_from_the_next_leader(
    cameras: Cameras, settings: Callable[[], CameraSettings]
) -> None:
    cameras.join("a")
    cameras.join("b")
    await set_on(settings(), "a", {Control.GAIN: 9.2})
    await set_on(settings(), "b", {Control.GAIN: 3.0})
    cameras.join("a")
    cameras.set.clear()
    await settings().give("a")
    assert cameras.set == [("a", Control.GAIN, 9.2)], "as requested, not as rounded by the camera"


async def test_a_new_camera_gets_what_all_others_that_are_here_have_in_common(
    cameras: Cameras, settings: Callable[[], CameraSettings]
) -> None:
    for name, gain in (("a", 9.0), ("b", 9.0), ("away", 4.0)):
        cameras.join(name)
        await set_on(settings(), name, {Control.GAIN: gain, Control.EXPOSURE: 1000.0 * gain})
    del cameras.states["away"]
    await set_on(settings(), "b", {Control.EXPOSURE: 500.0})
    cameras.join("new")
    cameras.set.clear()
    await settings().give("new")
    assert cameras.set == [("new", Control.GAIN, 9.0)], "their exposures differ"


async def test_a_control_in_another_unit_is_left_alone_and_a_missing_one_is_logged(
    cameras: Cameras, settings: Callable[[], CameraSettings], log: Log
) -> None:
    cameras.join("a")
    await set_on(settings(), "a", {Control.GAIN: 9.0, Control.EXPOSURE: 500.0})
    cameras.join("times", replace(GAIN, unit=TIMES))
    cameras.set.clear()
    await settings().give("times")
    assert cameras.set == []
    assert [line.text for line in log.after(0)] == [
        "TIMES: its exposure cannot be controlled, as the other cameras' can"
    ]


async def test_what_a_camera_cannot_take_is_logged_once(
    cameras: Cameras, settings: Callable[[], CameraSettings], log: Log
) -> None:
    cameras.join("a")
    await set_on(settings(), "a", {Control.GAIN: 9.0, Control.EXPOSURE: 500.0})
    cameras.problems = dict.fromkeys((Control.GAIN, Control.EXPOSURE), "the device is busy")
    cameras.join("b")
    await settings().give("b")
    assert [line.text for line in log.after(0)] == ["B: the device is busy"]


async def test_a_control_that_is_automatic_again_is_not_applied_any_more(
    cameras: Cameras, settings: Callable[[], CameraSettings]
) -> None:
    cameras.join("a")
    await set_on(settings(), "a", {Control.EXPOSURE: 500.0, Control.GAIN: 9.0})
    await set_on(settings(), "a", {Control.EXPOSURE: "auto"})
    cameras.join("a")
    cameras.set.clear()
    await settings().give("a")
    assert cameras.set == [("a", Control.GAIN, 9.0)]


async def test_a_control_that_is_held_gets_the_value_back_at_which_it_was(
    cameras: Cameras, settings: Callable[[], CameraSettings]
) -> None:
    cameras.join("a", replace(EXPOSURE, value=4000.0))
    await set_on(settings(), "a", {Control.EXPOSURE: "hold"})
    cameras.join("a", replace(EXPOSURE, value=700.0))
    cameras.set.clear()
    await settings().give("a")
    assert cameras.set == [("a", Control.EXPOSURE, 4000.0)]


async def test_a_camera_that_has_left_and_settings_that_are_damaged_harm_nobody(
    cameras: Cameras, settings: Callable[[], CameraSettings], tmp_path: Path, log: Log
) -> None:
    cameras.join("a")
    await set_on(settings(), "a", {Control.GAIN: 9.0})
    await settings().give("gone")
    (tmp_path / "sessions" / "_settings.json").write_text('{"a": {"ga')
    cameras.set.clear()
    await settings().give("a")
    assert (cameras.set, list(log.after(0))) == ([], [])
    await set_on(settings(), "a", {Control.GAIN: 4.0})
    cameras.set.clear()
    await settings().give("a")
    assert cameras.set == [("a", Control.GAIN, 4.0)]


async def test_what_a_camera_does_not_have_or_tell_is_not_stored(
    cameras: Cameras, settings: Callable[[], CameraSettings]
) -> None:
    cameras.join("a", GAIN, replace(EXPOSURE, value=None))
    await set_on(settings(), "a", {Control.GAIN: 9.0, Control.FOCUS: 3.0, Control.EXPOSURE: "hold"})
    cameras.states["a"][Control.EXPOSURE] = replace(EXPOSURE, value=None, automatic=False)
    await set_on(settings(), "a", {Control.EXPOSURE: "hold"})
    cameras.set.clear()
    await settings().give("a")
    assert cameras.set == [("a", Control.GAIN, 9.0)]


async def test_a_camera_is_asked_nothing_where_nothing_was_set(
    cameras: Cameras, settings: Callable[[], CameraSettings], tmp_path: Path
) -> None:
    cameras.join("a")
    await settings().ask(ControlsRequest(camera="a"))
    assert not (tmp_path / "sessions").exists(), "reading controls stores nothing"
    cameras.asked = 0
    await settings().give("a")
    assert cameras.asked == 0
