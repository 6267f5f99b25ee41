"""The mode Jobs: what is seen of jobs, and what its keys do."""

from pathlib import Path

import pytest
from textual.geometry import Region

from capture_app.tui.jobs.result_screen import ResultScreen
from capture_app.tui.widgets.picture import Picture
from tests.unit.tui.driving import settle, until
from tests.unit.tui.jobs.found import add_comparison
from tests.unit.tui.jobs.test_jobs_view import (
    jobs_mode,
    root,  # noqa: F401 - a fixture
    text,
)


@pytest.mark.parametrize("size", [(80, 24), (150, 24)])
async def test_pictures_are_switched_by_one_key(root: Path, size: tuple[int, int]) -> None:
    add_comparison(root, "take")
    async with jobs_mode(root, size) as pilot:
        await until(pilot, lambda: "✔ done" in text(pilot))
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(pilot.app.screen, ResultScreen))
        screen = pilot.app.screen
        await until(pilot, lambda: screen.query_one(Picture).cells is not None)
        titles = []
        for _ in range(3):
            titles.append((screen.picture.title, screen.shows_offset))
            await pilot.press("space")
            await settle(pilot)
            titles.append((screen.picture.title, screen.shows_offset))
            await pilot.press("space", "right")
            await settle(pilot)
        assert titles == [
            (title, offset) for title in ("Distance", "Panorama", "Late") for offset in (False, True)
        ]
        grey = screen.query_one(Picture).cells.inks.min()
        await pilot.press("space")
        await until(pilot, lambda: screen.query_one(Picture).cells.inks.min() > grey + 50)
        await pilot.click("#result-labels")
        await settle(pilot)
        assert not screen.shows_offset
        if size[0] < 150:
            await pilot.press("tab")
            await settle(pilot)
        figures = "\n".join(
            strip.text
            for strip in screen.query_one("#result-figures").render_lines(
                Region(0, 0, *screen.query_one("#result-figures").size)
            )
        )
        assert "96.8 %" in figures
        assert "no multiview" in figures
        await pilot.press("escape")
        await until(pilot, lambda: not isinstance(pilot.app.screen, ResultScreen))
