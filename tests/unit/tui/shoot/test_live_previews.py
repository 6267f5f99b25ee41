"""Previews of Shoot say of which moment they are: now, some seconds ago, or before a camera was lost."""

import asyncio
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from textual.app import App
from textual.geometry import Size
from textual.pilot import Pilot
from textual.screen import Screen

from capture_app.common.node_state import NodeState
from capture_app.protocol.status import BurstStatus, Preview
from capture_app.session.format.live_pictures import DepthPreview, LivePerson, PeoplePreview
from capture_app.tui.shoot.full_view import FullView
from capture_app.tui.shoot.preview_grid import PreviewTile
from capture_app.tui.widgets.cells import CellPicture
from capture_app.tui.widgets.lines import write_border
from capture_app.tui.widgets.picture import Source, draw_for
from tests.unit.tui.driving import until
from tests.unit.tui.shoot.studio import Studio, ready_rig

SECOND_NS = 1_000_000_000


def picture(level: int) -> bytes:
    colours = np.full((48, 64, 3), (level, 40, 200), np.uint8)
    return bytes(cv2.imencode(".png", colours)[1].tobytes())


class LiveStudio(Studio):
    """A studio whose clock the test moves, in seconds of the leader too."""

    def __init__(self, cameras: int, folder: Path) -> None:
        super().__init__(ready_rig(cameras), folder)
        self.now_s = 0.0
        self.app._record.clock = lambda: self.now_s

    def pass_time(self, seconds: float) -> None:
        self.now_s += seconds
        self.rig.different["now_ns"] = round(self.now_s * SECOND_NS)
        self.rig.tell()

    def show(
        self, camera: str, level: int = 0, *, completes: bool = False, instant_s: float | None = None
    ) -> None:
        instant_ns = round((self.now_s if instant_s is None else instant_s) * SECOND_NS)
        self.rig.tell(
            Preview(
                camera=camera,
                leader_ns=instant_ns,
                instant_ns=instant_ns,
                completes=completes,
                width=64,
                height=48,
                jpeg=picture(level),
            )
        )

    @property
    def tiles(self) -> tuple[PreviewTile, ...]:
        return self.view.stage.grid.tiles

    @property
    def title(self) -> str:
        return str(self.view.stage.border_title)

    async def show_all(self, pilot: Pilot[None], level: int = 0) -> None:
        for number, tile in enumerate(self.tiles, 1):
            self.show(tile._node.name, level, completes=number == len(self.tiles))
        await until(
            pilot, lambda: self.title.startswith("Live ·") and all(tile.picture.cells for tile in self.tiles)
        )


async def test_pictures_of_an_instant_are_shown_together(tmp_path: Path) -> None:
    studio = LiveStudio(2, tmp_path)
    async with studio.running(120, 40) as pilot:
        studio.show("cam00")
        await studio.settle(pilot)
        assert [tile.picture.cells for tile in studio.tiles] == [None, None], "the other one is on its way"
        studio.show("cam01", completes=True)
        await until(pilot, lambda: all(tile.picture.cells for tile in studio.tiles))
        assert studio.title == "Live · 2 pictures within 0 ns"


async def test_pictures_that_no_longer_come_are_not_live(tmp_path: Path) -> None:
    studio = LiveStudio(2, tmp_path)
    async with studio.running(120, 40) as pilot:
        await studio.show_all(pilot)
        studio.pass_time(90.0)
        await until(pilot, lambda: studio.title == "Not live · pictures of 90 s ago")
        assert all("90 s ago" in tile.title for tile in studio.tiles)
        assert all(tile.picture.is_faded for tile in studio.tiles)
        studio.pass_time(210.0)
        await until(pilot, lambda: studio.title == "Not live · pictures of 5 min ago")
        await studio.show_all(pilot, level=90)
        assert not any(tile.picture.is_faded for tile in studio.tiles)


async def test_pictures_are_dimmed_after_a_second_and_while_a_take_is_saved_after_two(tmp_path: Path) -> None:
    studio = LiveStudio(2, tmp_path)
    async with studio.running(120, 40) as pilot:
        await studio.show_all(pilot)
        studio.pass_time(1.5)
        await until(pilot, lambda: all(tile.picture.is_faded for tile in studio.tiles))
        studio.rig.burst_status = BurstStatus(
            burst=1, name="walk", cameras=2, instants=9, received=0, expected=18, recording=True
        )
        studio.pass_time(0.1)
        await until(pilot, lambda: not any(tile.picture.is_faded for tile in studio.tiles))
        studio.pass_time(0.5)
        await until(pilot, lambda: all(tile.picture.is_faded for tile in studio.tiles))


async def test_a_camera_that_is_behind_says_so_beside_the_live_ones(tmp_path: Path) -> None:
    studio = LiveStudio(3, tmp_path)
    async with studio.running(160, 40) as pilot:
        await studio.show_all(pilot)
        studio.pass_time(0.4)
        studio.show("cam00", 80)
        studio.show("cam02", 80, completes=True)
        await until(pilot, lambda: studio.tiles[1].picture.is_faded)
        assert "0.4 s ago" in studio.tiles[1].title
        assert "ago" not in studio.tiles[0].title
        assert studio.title.startswith("Live · 2 pictures within")


async def test_a_lost_camera_says_how_long_it_is_lost_and_not_how_old_its_picture_is(tmp_path: Path) -> None:
    studio = LiveStudio(2, tmp_path)
    async with studio.running(160, 40) as pilot:
        await studio.show_all(pilot)
        studio.pass_time(360.0)
        studio.rig.change("cam01", state=NodeState.LOST, last_seen_ns=13 * SECOND_NS)
        await until(pilot, lambda: studio.tiles[1].title.endswith("cam01 lost 13 s ago"))


async def test_a_click_opens_its_camera(tmp_path: Path) -> None:
    studio = LiveStudio(3, tmp_path)
    async with studio.running(120, 40) as pilot:
        await pilot.click(studio.tiles[1])
        await studio.settle(pilot)
        assert isinstance(studio.app.screen, FullView)
        assert studio.wishes[-1][0] == ("cam01",)


async def test_the_cursor_stays_among_the_cameras(tmp_path: Path) -> None:
    studio = LiveStudio(2, tmp_path)
    async with studio.running(120, 40) as pilot:
        grid = studio.view.stage.grid
        grid.focus()
        for key, camera in (("left", "cam00"), ("right", "cam01"), ("right", "cam01"), ("down", "cam01")):
            await pilot.press(key)
            assert grid.chosen() == camera


async def test_depth_takes_the_place_of_its_camera_until_it_ends(tmp_path: Path) -> None:
    studio = LiveStudio(2, tmp_path)
    async with studio.running(120, 40) as pilot:
        await studio.show_all(pilot)
        near = DepthPreview(0, "cam01", jpeg=picture(250), moving_confirmed=0.94, late_ns=300_000_000)
        preview = studio.tiles[1].picture.cells
        studio.view.stage.show_found(near)
        await until(pilot, lambda: studio.tiles[1].picture.cells is not preview)
        shown = studio.tiles[1].picture.cells
        assert studio.title == "Live · depth of cam01 · 94 % of moving pixels have depth"
        before = studio.tiles[0].picture.cells
        studio.pass_time(30.0)
        for camera in ("cam00", "cam01"):
            studio.show(camera, 90, completes=camera == "cam01")
        await until(pilot, lambda: studio.tiles[0].picture.cells is not before)
        assert studio.tiles[1].picture.cells is shown
        assert "ago" not in studio.tiles[1].title
        assert not studio.tiles[1].picture.is_faded
        found = (LivePerson(1, {}), LivePerson(2, {}))
        studio.view.stage.show_found(
            PeoplePreview(1, "cam01", jpeg=picture(9), people=found, absent={"cam00": ""})
        )
        assert studio.title.startswith("Live · 2 people · ")
        assert studio.title.endswith(" · without cam00")
        studio.view.stage.show_found(None)
        await studio.show_all(pilot, level=120)
        await until(pilot, lambda: studio.tiles[1].picture.cells is not shown)


async def test_a_lost_camera_is_grey(tmp_path: Path) -> None:
    studio = LiveStudio(2, tmp_path)
    async with studio.running(120, 40) as pilot:
        await studio.show_all(pilot)
        studio.rig.change("cam01", state=NodeState.LOST)
        await until(pilot, lambda: studio.tiles[1].picture.is_grey)
        tile = studio.tiles[1].picture
        line = tile.render_line(tile.size.height // 2)
        styles = [segment.style for segment in line if segment.text.strip()]
        colours = {style.color.triplet for style in styles if style is not None and style.color is not None}
        assert all(max(colour) - min(colour) <= 1 for colour in colours if colour is not None)
        assert not studio.tiles[0].picture.is_grey
        studio.rig.lose_link()
        await until(pilot, lambda: studio.tiles[0].picture.is_grey)


async def test_a_title_that_changes_draws_no_picture_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    studio = LiveStudio(2, tmp_path)
    async with studio.running(120, 40) as pilot:
        await studio.show_all(pilot)
        await studio.settle(pilot)
        spans: list[tuple[int, int, int]] = []
        display = studio.app._display

        def note(screen: Screen[Any], update: Any) -> None:
            spans.extend(getattr(update, "spans", [(0, 0, 9999)] * 40))
            display(screen, update)

        monkeypatch.setattr(studio.app, "_display", note)
        write_border(studio.view.stage, "Live · 2 pictures of another instant")
        await until(pilot, lambda: bool(spans))
        assert {row for row, _, _ in spans} == {studio.view.stage.region.y}


async def test_pictures_that_were_drawn_before_a_resize_are_drawn_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    studio, is_resized = LiveStudio(1, tmp_path), asyncio.Event()

    async def draw_late(app: App[Any], source: Source, size: Size) -> CellPicture | None:
        cells = await draw_for(app, source, size)
        await is_resized.wait()
        return cells

    monkeypatch.setattr("capture_app.tui.shoot.preview_grid.draw_for", draw_late)
    async with studio.running(160, 40) as pilot:
        studio.show("cam00", completes=True)
        await pilot.pause()
        await pilot.resize_terminal(110, 40)
        is_resized.set()
        picture = studio.tiles[0].picture
        await until(
            pilot, lambda: picture.cells is not None and picture.cells.size.width == picture.size.width
        )
