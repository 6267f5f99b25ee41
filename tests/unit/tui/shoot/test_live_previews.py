"""Previews of Shoot say of which moment they are: now, some seconds ago, or before a camera was lost."""

from pathlib import Path

import cv2
import numpy as np
from textual.pilot import Pilot

from capture_app.common.node_state import NodeState
from capture_app.protocol.status import Preview
from capture_app.tui.shoot.preview_grid import PreviewTile
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
    async with studio.app.run_test(size=(120, 40)) as pilot:
        await studio.enter(pilot)
        studio.show("cam00")
        await studio.settle(pilot)
        assert [tile.picture.cells for tile in studio.tiles] == [None, None], "the other one is on its way"
        studio.show("cam01", completes=True)
        await until(pilot, lambda: all(tile.picture.cells for tile in studio.tiles))
        assert studio.title == "Live · 2 pictures of one instant, within 0 ns"


async def test_pictures_that_no_longer_come_are_not_live(tmp_path: Path) -> None:
    studio = LiveStudio(2, tmp_path)
    async with studio.app.run_test(size=(120, 40)) as pilot:
        await studio.enter(pilot)
        await studio.show_all(pilot)
        studio.pass_time(90.0)
        await until(pilot, lambda: studio.title == "Not live · pictures of 90 s ago")
        assert all("90 s ago" in tile.title for tile in studio.tiles)
        assert all(tile.picture.has_class("old") for tile in studio.tiles)
        await studio.show_all(pilot, level=90)
        assert not any(tile.picture.has_class("old") for tile in studio.tiles)


async def test_a_camera_that_is_behind_says_so_beside_the_live_ones(tmp_path: Path) -> None:
    studio = LiveStudio(3, tmp_path)
    async with studio.app.run_test(size=(160, 40)) as pilot:
        await studio.enter(pilot)
        await studio.show_all(pilot)
        studio.pass_time(0.4)
        studio.show("cam00", 80)
        studio.show("cam02", 80, completes=True)
        await until(pilot, lambda: studio.tiles[1].picture.has_class("old"))
        assert "0.4 s ago" in studio.tiles[1].title
        assert "ago" not in studio.tiles[0].title
        assert studio.title.startswith("Live · 2 pictures of one instant")


async def test_a_lost_camera_is_grey(tmp_path: Path) -> None:
    studio = LiveStudio(2, tmp_path)
    async with studio.app.run_test(size=(120, 40)) as pilot:
        await studio.enter(pilot)
        await studio.show_all(pilot)
        studio.rig.change("cam01", state=NodeState.LOST)
        await until(pilot, lambda: studio.tiles[1].picture.is_grey)
        tile = studio.tiles[1].picture
        styles = [segment.style for segment in tile.render_line(tile.size.height // 2)]
        colours = {style.color.triplet for style in styles if style is not None and style.color is not None}
        assert all(max(colour) - min(colour) <= 1 for colour in colours if colour is not None)
        assert not studio.tiles[0].picture.is_grey
        studio.rig.lose_link()
        await until(pilot, lambda: studio.tiles[0].picture.is_grey)
