"""The widget on a screen: what it draws, and what it draws again."""

import cv2
import numpy as np
import pytest
from textual.app import App, ComposeResult

from capture_app.tui.widgets.cells import Palette
from capture_app.tui.widgets.focus_aids import zebra
from capture_app.tui.widgets.picture import Picture, Source
from tests.unit.tui.driving import finish_work

RED = np.full((48, 64, 3), (0, 0, 255), np.uint8)


class PictureApp(App[None]):
    def __init__(self, source: Source | None, words: str = "") -> None:
        super().__init__()
        self.source = source
        self.picture = Picture(words=words)

    def compose(self) -> ComposeResult:
        yield self.picture

    def on_mount(self) -> None:
        self.picture.show(self.source)


def text_of(app: PictureApp) -> list[str]:
    return [app.picture.render_line(y).text for y in range(app.picture.size.height)]


async def test_it_fits_and_is_in_the_middle() -> None:
    app = PictureApp(RED)
    async with app.run_test(size=(80, 24)) as pilot:
        await finish_work(pilot)
        lines = text_of(app)
        assert lines == [" " * 8 + "▀" * 64 + " " * 8] * 24
        await pilot.resize_terminal(40, 24)
        await finish_work(pilot)
        assert text_of(app) == [" " * 40] * 4 + ["▀" * 40] * 15 + [" " * 40] * 5


async def test_bytes_pixels_and_loaders_show_the_same() -> None:
    encoded = cv2.imencode(".png", RED)[1].tobytes()
    for source in (RED, encoded, lambda: RED, lambda: encoded):
        app = PictureApp(source)
        async with app.run_test(size=(20, 5)) as pilot:
            await finish_work(pilot)
            assert app.picture.cells is not None
            assert (app.picture.cells.inks == (255, 0, 0)).all()


async def test_words_where_there_is_no_picture() -> None:
    app = PictureApp(b"no image", words="nothing \x1b[31m yet")
    async with app.run_test(size=(30, 5)) as pilot:
        await finish_work(pilot)
        assert app.picture.cells is None
        assert text_of(app)[2].strip() == "nothing \\x1b[31m yet"
        app.picture.show(RED)
        await finish_work(pilot)
        assert app.picture.cells is not None
        app.picture.show(None)
        await finish_work(pilot)
        assert app.picture.cells is None


async def test_the_same_picture_is_not_drawn_again() -> None:
    calls = []

    def load() -> np.ndarray:
        calls.append(1)
        return RED

    app = PictureApp(load)
    async with app.run_test(size=(30, 5)) as pilot:
        await finish_work(pilot)
        drawn = app.picture.cells
        app.picture.show(load)
        app.picture.show_aids(())
        await finish_work(pilot)
        assert len(calls) == 1
        assert app.picture.cells is drawn


async def test_only_the_newest_of_many_is_drawn_at_last() -> None:
    app = PictureApp(None)
    async with app.run_test(size=(30, 5)) as pilot:
        for level in range(0, 250, 10):
            app.picture.show(np.full((48, 64), level, np.uint8))
        await finish_work(pilot)
        assert app.picture.cells is not None
        assert (app.picture.cells.inks == 240).all()


async def test_aids_are_painted() -> None:
    app = PictureApp(np.full((48, 64), 255, np.uint8))
    async with app.run_test(size=(80, 24)) as pilot:
        app.picture.show_aids([zebra])
        await finish_work(pilot)
        assert app.picture.cells is not None
        colours = {tuple(ink) for ink in app.picture.cells.inks.reshape(-1, 3).tolist()}
        assert (255, 200, 0) in colours


@pytest.mark.parametrize(("theme", "palette"), [("textual-dark", Palette.GREYS), ("ansi-dark", Palette.DOTS)])
async def test_without_colour(theme: str, palette: Palette, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    app = PictureApp(RED)
    app.theme = theme
    async with app.run_test(size=(30, 5)) as pilot:
        await finish_work(pilot)
        assert app.picture.cells is not None
        assert app.picture.cells.palette is palette
