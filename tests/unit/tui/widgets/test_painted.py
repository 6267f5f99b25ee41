"""Rows whose escape sequences NumPy makes show what rows of segments show, whole and in parts."""

import re

import numpy as np
import pytest
from rich.console import Console
from rich.style import Style
from textual.strip import Strip

from capture_app.tui.widgets.cells import Palette, draw_cells
from capture_app.tui.widgets.painted import PaintedStrip, blank_code
from tests.unit.tui.widgets.test_cells import scene

TRUE_COLOURS = Console(color_system="truecolor", force_terminal=True)
PART = re.compile(r"\x1b\[([0-9;]*)m([^\x1b]*)")


def cells_of(rendered: str) -> list[tuple[str, str]]:
    """Each cell's codes and glyph, of text for a terminal."""
    return [(codes, glyph) for codes, glyphs in PART.findall(rendered) for glyph in glyphs]


def both(row: int = 5) -> tuple[PaintedStrip, Strip]:
    cells = draw_cells(scene(80, 24), Palette.TRUECOLOR)
    return PaintedStrip(cells.codes[row], lambda: cells.strip(row, Style())), cells.strip(row, Style())


@pytest.mark.parametrize(("start", "end"), [(0, None), (0, 17), (9, 31), (39, 40)])
def test_a_part_shows_the_same_cells(start: int, end: int | None) -> None:
    painted, plain = (strip.crop(start, end) for strip in both())
    assert isinstance(painted, PaintedStrip)
    assert cells_of(painted.render(TRUE_COLOURS)) == cells_of(plain.render(TRUE_COLOURS))
    assert painted.text == plain.text
    assert painted.cell_length == plain.cell_length


def test_parts_of_a_row_are_those_of_segments() -> None:
    painted, plain = (strip.divide([7, 30, 40]) for strip in both())
    assert [one.text for one in painted] == [one.text for one in plain]
    assert [cells_of(one.render(TRUE_COLOURS)) for one in painted] == [
        cells_of(one.render(TRUE_COLOURS)) for one in plain
    ]


def test_a_colour_that_stays_is_said_once() -> None:
    grey = draw_cells(np.full((2, 80, 3), 90, np.uint8), Palette.TRUECOLOR)
    text = PaintedStrip(grey.codes[0], lambda: grey.strip(0, Style())).render(TRUE_COLOURS)
    assert text.count("\x1b[38") == 1
    assert len(cells_of(text)) == 40


def test_a_terminal_of_256_colours_gets_its_own() -> None:
    painted, plain = both()
    console = Console(color_system="256", force_terminal=True)
    assert painted.render(console) == plain.render(console)


def test_a_margin_has_the_background_alone() -> None:
    margin = PaintedStrip(np.tile(blank_code(Style.parse("red on #010203")), (3, 1)), list)
    assert margin.render(TRUE_COLOURS) == "\x1b[48;2;1;2;3m   \x1b[0m"
