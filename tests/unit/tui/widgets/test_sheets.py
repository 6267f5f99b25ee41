"""The contact sheet and the pictures of a take, as a user looks through them."""

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from textual.app import App, ComposeResult
from textual.pilot import Pilot

from capture_app.session.format.manifest import BurstRecord, CameraRecord, MissingImage
from capture_app.session.reading.reader import Session
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.tui.widgets.contact_sheet import ContactSheet
from capture_app.tui.widgets.look import LookScreen, Motion, ping_pong
from capture_app.tui.widgets.picture import Picture
from tests.facts import make_facts
from tests.project import JUMPER
from tests.unit.tui.driving import finish_work
from tests.unit.tui.takes import make_take, picture_of

SAMPLE = JUMPER


class SheetApp(App[None]):
    def __init__(self, sheet: TakeSheet) -> None:
        super().__init__()
        self.sheet = sheet
        self.contact = ContactSheet()

    def compose(self) -> ComposeResult:
        yield self.contact

    def on_mount(self) -> None:
        self.contact.show(self.sheet)


def text_of(sheet: ContactSheet) -> list[str]:
    return [sheet.render_line(y).text.rstrip() for y in range(sheet.size.height)]


async def test_cameras_are_across_by_name_and_instants_down() -> None:
    app = SheetApp(TakeSheet.open(SAMPLE))
    async with app.run_test(size=(120, 40)) as pilot:
        await finish_work(pilot)
        lines = text_of(app.contact)
        assert lines[0].split() == ["instant", "cam00", "cam01", "cam04", "cam05", "cam06"]
        times = [line[:8].strip() for line in lines[1:] if line[:8].strip() and "↔" not in line[:8]]
        assert times == ["first", "+33 ms", "+67 ms", "+100 ms", "+133 ms"]
        assert sum("▀" in line or "▌" in line for line in lines) > 30


@pytest.mark.parametrize(("key", "motion"), [("P", "play"), ("b", "cameras"), ("w", "wiggle")])
async def test_the_keys_of_a_picture_start_its_motion_from_the_sheet(key: str, motion: Motion) -> None:
    app = SheetApp(TakeSheet.open(SAMPLE))
    async with app.run_test(size=(120, 40)) as pilot:
        app.contact.focus()
        await pilot.press(key)
        await finish_work(pilot)
        shown: Any = app.screen
        assert isinstance(shown, LookScreen)
        assert shown.motion == motion


async def test_a_picture_that_is_being_read_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    load, may_read = TakeSheet.load, threading.Event()

    def load_late(sheet: TakeSheet, *which: Any) -> Any:
        may_read.wait()
        return load(sheet, *which)

    monkeypatch.setattr(TakeSheet, "load", load_late)
    app = SheetApp(TakeSheet.open(SAMPLE))
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.pause()
        reading = "\n".join(text_of(app.contact))
        may_read.set()
        await finish_work(pilot)
        assert "loading …" in reading
        assert "loading" not in "\n".join(text_of(app.contact))


async def test_what_is_missing_late_or_beside_is_said_in_its_place(tmp_path: Path) -> None:
    camera = CameraRecord(name="left", facts=make_facts(width=32, height=24))
    writer = SessionWriter.create(tmp_path, "take")
    differences: tuple[dict[str, Any], ...] = (
        {},
        {"late": True, "residual_ns": 3_100_000},
        {"substitute": True},
    )
    for instant, more in enumerate(differences):
        writer.add_image(
            picture_of(instant), camera="left", instant=instant, leader_ns=instant * 10**8, **more
        )
    gone = MissingImage(camera="left", instant=3, reason="lost \x1b[31m on its way")
    burst = BurstRecord(instants_ns=tuple(n * 10**8 for n in range(4)), period_ns=10**8)
    app = SheetApp(TakeSheet(writer.finish([camera], burst, [gone], "captured")))
    async with app.run_test(size=(60, 110)) as pilot:
        await finish_work(pilot)
        text = "\n".join(text_of(app.contact))
        assert "! +3.1 ms off" in text
        assert "! neighbouring frame" in text
        assert "! lost \\x1b[31m on its way" in text
        assert "no picture" in text


async def test_of_a_large_take_only_what_is_seen_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sheet = TakeSheet(make_take(tmp_path, cameras=20, instants=12))
    read: list[tuple[str, int]] = []
    load = TakeSheet.load

    def note(self: TakeSheet, camera: str, instant: int, width: int = 0) -> "np.ndarray | None":
        read.append((camera, instant))
        return load(self, camera, instant, width)

    monkeypatch.setattr(TakeSheet, "load", note)
    app = SheetApp(sheet)
    async with app.run_test(size=(80, 24)) as pilot:
        await finish_work(pilot)
        assert 0 < len(read) < 60
        assert ("cam19", 11) not in read
        app.contact.go_to("cam19", 11)
        await finish_work(pilot)
        assert ("cam19", 11) in read
        assert len(read) == len(set(read))
        assert "cam19" in text_of(app.contact)[0]


async def test_the_sheet_fits_again_when_the_window_changes(tmp_path: Path) -> None:
    app = SheetApp(TakeSheet(make_take(tmp_path, cameras=4, instants=3)))
    async with app.run_test(size=(80, 24)) as pilot:
        await finish_work(pilot)
        before = app.contact.thumb_size
        await pilot.resize_terminal(200, 50)
        await finish_work(pilot)
        assert app.contact.thumb_size.width > before.width
        app.contact.focus()
        await pilot.press("minus", "minus")
        assert app.contact.thumb_size.width < 46
        await finish_work(pilot)
        assert "▀" in "".join(text_of(app.contact))


def test_a_ping_pong_shows_no_end_twice() -> None:
    assert ping_pong(range(4)) == [0, 1, 2, 3, 2, 1]
    assert ping_pong(range(2)) == [0, 1]
    assert ping_pong(range(1)) == [0]


class NotedLook(LookScreen):
    """Notes each place that it comes to show, however quickly the next one follows."""

    def __init__(self, *shown: Any) -> None:
        super().__init__(*shown)
        self.seen: list[tuple[str, int]] = []

    @property
    def shown(self) -> tuple[str, int]:
        place = super().shown
        if place not in self.seen[-1:]:
            self.seen.append(place)
        return place


class LookApp(App[None]):
    def __init__(self, session: Session, motion: Motion = "still") -> None:
        super().__init__()
        self.look = NotedLook(TakeSheet(session), "cam01", 1, motion)
        self.closed_at: tuple[str, int] | None = None

    def on_mount(self) -> None:
        self.push_screen(self.look, lambda at: setattr(self, "closed_at", at))


async def test_one_picture_is_looked_at_and_left_where_the_user_went(tmp_path: Path) -> None:
    app = LookApp(make_take(tmp_path, cameras=3, instants=3))
    async with app.run_test(size=(80, 24)) as pilot:
        await finish_work(pilot)
        picture = app.look.query_one(Picture)
        assert picture.cells is not None
        first = picture.cells.inks.mean(axis=(0, 1, 2))
        await pilot.press("right", "down", "right")
        await finish_work(pilot)
        assert app.look.shown == ("cam02", 2)
        assert not np.allclose(picture.cells.inks.mean(axis=(0, 1, 2)), first, atol=5)
        await pilot.press("escape")
        await pilot.pause()
        assert app.closed_at == ("cam02", 2)


@pytest.mark.parametrize(
    ("key", "places"),
    [
        ("b", [("cam01", 1), ("cam02", 1), ("cam01", 1)]),
        ("B", [("cam01", 1), ("cam01", 2), ("cam01", 1)]),
        (
            "w",
            [
                ("cam00", 1),
                ("cam01", 1),
                ("cam02", 1),
                ("cam03", 1),
                ("cam02", 1),
                ("cam01", 1),
                ("cam00", 1),
            ],
        ),
        ("P", [("cam01", 0), ("cam01", 1), ("cam01", 2), ("cam01", 0)]),
    ],
)
async def test_what_moves_by_itself(tmp_path: Path, key: str, places: list[tuple[str, int]]) -> None:
    app = LookApp(make_take(tmp_path, cameras=4, instants=3))
    async with app.run_test(size=(80, 24)) as pilot:
        app.look.seen.clear()
        await pilot.press(key, "plus", "plus", "plus", "plus")
        while len(app.look.seen) < len(places):
            await pilot.pause(0.02)
        assert app.look.seen[: len(places)] == places
        await pilot.press(key)
        still = app.look.shown
        assert app.look.motion == "still"
        await pilot.press("escape")
        await pilot.pause()
        assert app.closed_at == still


def test_the_sheet_looks_as_it_did(snap_compare: Any, tmp_path: Path) -> None:
    app = SheetApp(TakeSheet(make_take(tmp_path, cameras=5, instants=5)))

    async def before(pilot: Pilot[None]) -> None:
        app.contact.focus()
        await pilot.press("right", "down")
        await finish_work(pilot)

    assert snap_compare(app, terminal_size=(120, 40), run_before=before)
