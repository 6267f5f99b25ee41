"""The director's monitor by a QR code: the dialog fits, and its page is served until the screen ends."""

import aiohttp

from tests.unit.tui.driving import lines, make_app, running, text, until
from tests.unit.tui.fake_rig import FakeRig


async def test_the_code_of_the_monitor_fits_and_its_page_goes_on_when_the_dialog_is_closed() -> None:
    app = make_app(FakeRig(5))
    async with running(app) as pilot:
        await pilot.press("g")
        await until(pilot, lambda: app.screen.id == "monitor-guide" and lines(app, "#monitor-code"))
        code, words = lines(app, "#monitor-code"), lines(app, "#monitor-words")
        assert max(map(len, words)) + max(map(len, code)) <= 74
        assert max(len(code), len(words)) <= 22
        address = text(app, "#monitor-words").replace("\n", "").partition("https://")[2].partition("/#")[0]
        await pilot.press("escape")
        await until(pilot, lambda: app.screen.id != "monitor-guide")
        async with (
            aiohttp.ClientSession() as session,
            session.get(f"https://127.0.0.1:{address.rpartition(':')[2]}/", ssl=False) as page,
        ):
            assert "simulshot monitor" in await page.text()
