"""Lines and lists of rows: which of their cells are drawn again, and where a list's rows end."""

from rich.segment import Segment
from rich.style import Style
from textual.app import App, ComposeResult
from textual.content import Content
from textual.strip import Strip

from capture_app.tui.widgets.lines import Lines, changed_cells, justified
from capture_app.tui.widgets.row_list import RowList
from tests.unit.tui.driving import settle


def strip(*parts: tuple[str, str]) -> Strip:
    return Strip(Segment(text, Style.parse(style)) for text, style in parts)


def test_only_the_cells_that_differ_are_drawn_again() -> None:
    before = strip(("cam00 ", "bold"), ("−45 µs", "green"))
    assert changed_cells(before, strip(("cam00 −45 µs", "bold"))) == (6, 12)
    assert changed_cells(before, strip(("cam", "bold"), ("00 ", "bold"), ("−45 µs", "green"))) == (0, 0)
    assert changed_cells(before, strip(("cam00 ", "bold"), ("+45 µs", "green"))) == (6, 7)
    assert changed_cells(before, strip(("cam00", "bold"))) == (0, 12)
    assert changed_cells(strip(), before) == (0, 12)


def test_a_line_with_wide_characters_is_drawn_again_as_a_whole() -> None:
    before, after = strip(("庭 ready", "")), strip(("庭 lost ", ""))
    assert changed_cells(before, after) == (0, before.cell_length)
    assert changed_cells(before, strip(("a ready", ""))) == (0, 8)


class ListApp(App[None]):
    CSS = "RowList { scrollbar-size-vertical: 1; }"

    def compose(self) -> ComposeResult:
        yield RowList[str](1, lambda name, width, _: [justified(Content(name), Content("end"), width)])


class WordsApp(App[None]):
    CSS = "Lines { width: auto; }"

    def compose(self) -> ComposeResult:
        yield Lines()


async def test_a_line_that_grows_is_not_cut() -> None:
    async with WordsApp().run_test(size=(40, 3)) as pilot:
        words = pilot.app.query_one(Lines)
        for text in ("in 3 s", "take 1 of 3 in 3 s"):
            words.show([Content(text)])
            await settle(pilot)
            assert words.render_line(0).text == text


async def test_the_rows_of_a_long_list_end_before_its_scrollbar() -> None:
    async with ListApp().run_test(size=(20, 6)) as pilot:
        rows: RowList[str] = pilot.app.query_one(RowList)
        for number in (3, 30):
            rows.show_items({str(n): f"row {n}" for n in range(number)})
            await settle(pilot)
            seen = rows.scrollable_content_region.width
            assert seen == (20 if number == 3 else 19)
            assert rows.render_line(0).text[:seen] == f"row 0{'end':>{seen - 5}}"
