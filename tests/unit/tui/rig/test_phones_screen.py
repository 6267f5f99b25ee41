"""Phones by a QR code: the code of the next one beside what to do, and the error where there is none."""

from capture_app.common.errors import NetworkError
from tests.unit.tui.driving import lines, make_app, running, text, until
from tests.unit.tui.fake_rig import FakeRig


async def test_the_code_and_the_steps_fit_and_the_next_phone_gets_another() -> None:
    rig = FakeRig(5)
    app = make_app(rig)
    async with running(app) as pilot:
        await pilot.press("h")
        await until(pilot, lambda: app.screen.id == "phones-guide" and lines(app, "#phones-code"))
        code, words = lines(app, "#phones-code"), text(app, "#phones-words")
        assert max(map(len, lines(app, "#phones-words"))) + max(map(len, code)) <= 74
        assert max(len(code), len(lines(app, "#phones-words"))) <= 22
        assert "https://192.168.1.20:47011/#" in words
        assert "A7:A7" in words
        rig.phones_come += 1
        await until(pilot, lambda: "For the next device" in text(app, "#phones-words"))
        assert lines(app, "#phones-code") != code
        await pilot.press("escape")
        await until(pilot, lambda: app.screen.id != "phones-guide")


async def test_the_start_offers_phones_and_says_why_there_are_none() -> None:
    rig = FakeRig()
    app = make_app(rig)
    async with running(app) as pilot:
        rig.phones_failure = NetworkError("cannot listen on 0.0.0.0:47011")
        await pilot.press("h")
        await until(pilot, lambda: app.screen.id == "phones-guide")
        await until(pilot, lambda: "cannot listen" in text(app, "#phones-words"))
        rig.phones_failure = None
        # It is asked again.
        await until(pilot, lambda: "Scan the code" in text(app, "#phones-words"))
