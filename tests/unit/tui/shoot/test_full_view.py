"""A camera full size, its aids, and two cameras blinked."""

import asyncio
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from textual.pilot import Pilot

from capture_app.common.node_state import NodeState
from capture_app.protocol.status import Preview
from capture_app.tui.shoot.full_view import FullView
from capture_app.tui.shoot.preview_grid import PreviewGrid
from capture_app.tui.widgets.focus_aids import sharpness
from capture_app.tui.widgets.lines import Lines
from capture_app.tui.widgets.picture import Picture
from tests.facts import make_facts
from tests.unit.tui.shoot.studio import Studio, ready_rig


def board(blur: float = 0.0, light: int = 0) -> bytes:
    """A chess board, in focus or not, as a preview's bytes."""
    squares = np.kron(np.indices((12, 16)).sum(axis=0) % 2, np.ones((20, 20))) * 160 + 40 + light
    image = np.clip(np.repeat(squares[..., None], 3, axis=2), 0, 255).astype(np.uint8)
    image = cv2.GaussianBlur(image, (0, 0), blur) if blur else image
    return bytes(cv2.imencode(".jpg", image)[1].tobytes())


async def open_first(studio: Studio, pilot: Pilot[None]) -> FullView:
    await studio.enter(pilot)
    studio.app.screen.query_one(PreviewGrid).focus()
    await pilot.press("enter")
    await studio.settle(pilot)
    assert isinstance(studio.app.screen, FullView)
    return studio.app.screen


def text(screen: FullView, part: str) -> str:
    return "\n".join(screen.query_one(part, Lines).plain)


async def test_a_camera_is_opened_and_left(tmp_path: Path) -> None:
    studio = Studio(ready_rig(3), tmp_path)
    async with studio.app.run_test(size=(100, 30)) as pilot:
        finder = await open_first(studio, pilot)
        assert studio.wishes[-1] == (("cam00",), 640, 10.0)
        assert text(finder, ".title") == "cam00 · ● ready · 30.0 fps · exposure 10 ms · gain 1.5"
        studio.rig.change("cam00", state=NodeState.LOST)
        await studio.settle(pilot)
        assert "lost" in text(finder, ".title")
        await pilot.press("right")
        await studio.settle(pilot)
        assert studio.wishes[-1] == (("cam01",), 640, 10.0)
        await pilot.press("escape")
        await studio.settle(pilot)
        assert studio.wishes[-2][2] == 0.0
        assert studio.wishes[-1] == (None, 128, 2.5), "the previews of all are asked for again"
        assert studio.view.stage.grid.tiles[1].title.startswith("▸")


async def test_a_camera_is_called_as_its_owner_wrote(tmp_path: Path) -> None:
    studio = Studio(ready_rig(2), tmp_path)
    studio.rig.change("cam00", camera=make_facts(label="カメラ左"))
    async with studio.app.run_test(size=(100, 30)) as pilot:
        finder = await open_first(studio, pilot)
        assert studio.wishes[-1][0] == ("cam00",), "by its name it is known"
        assert text(finder, ".title").startswith("カメラ左 · ● ready")
        await pilot.press("b")
        await studio.settle(pilot)
        assert "blinking カメラ左 ↔ cam01" in text(finder, ".title")
        assert "カメラ左" in studio.view.stage.grid.tiles[0].title


async def test_pictures_that_come_faster_than_they_are_measured_are_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def measure_slowly(image: np.ndarray) -> float:
        time.sleep(0.3)
        return sharpness(image)

    monkeypatch.setattr("capture_app.tui.shoot.full_view.sharpness", measure_slowly)
    rig = ready_rig(2)
    studio = Studio(rig, tmp_path)
    async with studio.app.run_test(size=(100, 30)) as pilot:
        finder = await open_first(studio, pilot)
        for light in range(100):
            rig.preview("cam00", board(light=light), 320, 240)
            await asyncio.sleep(0.1)
            if finder.query_one(Picture).cells is not None:
                break
        assert finder.focus_numbers
        assert finder.query_one(Picture).cells is not None


async def test_focus_and_light_are_numbers_and_marks(tmp_path: Path) -> None:
    rig = ready_rig(2)
    studio = Studio(rig, tmp_path)
    async with studio.app.run_test(size=(100, 30)) as pilot:
        finder = await open_first(studio, pilot)
        for blur in (0.0, 3.0):
            rig.preview("cam00", board(blur), 320, 240)
            rig.preview("cam01", board(), 320, 240)
            await studio.settle(pilot)
        sharp, blurred = (number for _, number in finder.focus_numbers)
        assert blurred < 0.3 * sharp
        assert "of the best in 10 s" in text(finder, "#finder-meters")
        assert "clipped white 0.0%" in text(finder, "#finder-meters")
        rig.preview("cam00", board(light=80), 320, 240)
        await studio.settle(pilot)
        assert "▲ clipped white 50." in text(finder, "#finder-meters")
        before = finder.query_one(Picture).cells
        await pilot.press("z", "f")
        await studio.settle(pilot)
        after = finder.query_one(Picture).cells
        assert before is not None
        assert after is not None
        colours = {tuple(ink) for ink in after.inks.reshape(-1, 3).tolist()}
        assert (255, 60, 60) in colours
        assert any(red > 200 and 150 < green < 230 and blue < 60 for red, green, blue in colours)
        assert text(finder, ".title").endswith("focus on · zebra on")
        await pilot.press("M")
        assert not finder.query_one("#finder-meters").display


async def test_two_cameras_are_blinked_at_the_nearest_instant(tmp_path: Path) -> None:
    rig = ready_rig(3)
    studio = Studio(rig, tmp_path)
    async with studio.app.run_test(size=(120, 30)) as pilot:
        finder = await open_first(studio, pilot)
        await pilot.press("b")
        await studio.settle(pilot)
        assert studio.wishes[-1] == (("cam00", "cam01"), 640, 5.0)
        assert "blinking cam00 ↔ cam01, waiting for both" in text(finder, ".title")
        assert text(finder, "#finder-meters") == ""
        for camera, leader_ns, level in (("cam00", 10**9, 50), ("cam01", 10**9 + 4_200_000, 200)):
            jpeg = cv2.imencode(".jpg", np.full((48, 64), level, np.uint8))[1].tobytes()
            rig.tell(Preview(camera=camera, leader_ns=leader_ns, width=64, height=48, jpeg=bytes(jpeg)))
        seen: set[Any] = set()
        while len(seen) < 2:
            await pilot.pause(0.05)
            cells = finder.query_one(Picture).cells
            if cells is not None:
                seen.add(round(float(cells.inks.mean()) / 10) * 10)
        assert seen == {50, 200}
        assert "4.2 ms apart" in text(finder, ".title")
        await pilot.press("b")
        await studio.settle(pilot)
        assert "blinking" not in text(finder, ".title")
