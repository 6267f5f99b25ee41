"""The contact sheet and the pictures of a take, as a user looks through them."""

from textual.app import App

from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.tui.widgets.contact_sheet import ContactSheet
from capture_app.tui.widgets.look import LookScreen
from tests.unit.tui.driving import screen_of
from tests.unit.tui.widgets.test_sheets import SAMPLE, SheetApp


def looked_at(app: App[None]) -> tuple[str, int]:
    return screen_of(app, LookScreen).shown


async def test_a_picture_is_chosen_with_arrows_and_enter_or_two_clicks() -> None:
    app = SheetApp(TakeSheet.open(SAMPLE))
    async with app.run_test(size=(120, 40)) as pilot:
        app.contact.focus()
        await pilot.press("right", "right", "left", "down", "enter")
        await pilot.pause()
        assert looked_at(app) == ("cam01", 1)
        await pilot.press("escape", *["up"] * 3, *["right"] * 5, "enter")
        await pilot.pause()
        assert looked_at(app) == ("cam06", 0)
        await pilot.press("left", "escape")
        await pilot.pause()
        assert app.contact.cursor == (3, 0), "it comes back to what was seen last"
        await pilot.click(ContactSheet, offset=(60, 14))
        assert not isinstance(app.screen, LookScreen)
        await pilot.click(ContactSheet, offset=(60, 14))
        await pilot.pause()
        assert looked_at(app) == ("cam04", 1)
