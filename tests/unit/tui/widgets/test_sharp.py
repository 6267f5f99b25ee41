"""Pictures in the terminal's own pixels: who gets them, and what is sent. The terminal is the test itself."""

import base64
import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from textual.app import App

from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.tui.widgets.look import LookScreen
from capture_app.tui.widgets.picture import Picture, SharpTerminal
from tests.project import JUMPER, ROOT
from tests.unit.tui.driving import finish_work, until
from tests.unit.tui.widgets.screen_of_a_picture import END
from tests.unit.tui.widgets.sent import PLACEHOLDER, Sent

GLYPHS = re.compile("[▀▘▌▚▛▜▙]")
ASKED_ATTRIBUTES, ASKED_KITTY = b"\x1b[c", re.compile(rb"\x1b_Gi=(\d+),[^\x1b]*a=q[^\x1b]*\x1b\\")
KITTY, WEZTERM, XTERM = (b"\x1b[?62;c", True), (b"\x1b[?65;4;6;18;22c", True), (b"\x1b[?64;1;2;6;22c", False)
MUTE = (b"", False)
SAMPLE = JUMPER


def received_from(ours: int) -> Iterator[bytes]:
    """Yield all that a terminal has received, whenever there is more, until its other end is closed."""
    received = b""
    while select.select([ours], [], [], 60)[0]:
        try:
            received += os.read(ours, 65536)
        except OSError:  # Linux tells so that the other end is closed
            return
        yield received


def sent_to(*terminals: tuple[bytes, bool], choice: str = "local", **environment: str) -> list[str]:
    """All that a screen with one picture sends to each of these terminals, of 40x12 cells of 8x16 pixels."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 12, 40, 40 * 8, 12 * 16))
    # A screen believes the size that earlier tests may have put there rather than its terminal.
    never = ("SSH_CONNECTION", "SSH_TTY", "NO_COLOR", "COLUMNS", "LINES")
    kept = {name: value for name, value in os.environ.items() if name not in never}
    command = [sys.executable, "-m", "tests.unit.tui.widgets.screen_of_a_picture", *[choice] * len(terminals)]
    child = subprocess.Popen(
        command,
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        cwd=ROOT,
        env=kept | {"TERM": "xterm-256color", "COLORTERM": "truecolor"} | environment,
        start_new_session=True,
    )
    os.close(theirs)
    sent, answered = b"", 0
    try:
        for sent in received_from(ours):
            if END in sent[answered:]:
                answered = sent.index(END, answered) + len(END)
            attributes, knows_kitty = (*terminals, MUTE)[sent.count(END)]
            if ASKED_ATTRIBUTES in sent[answered:]:
                os.write(ours, attributes)
                answered = sent.index(ASKED_ATTRIBUTES, answered) + len(ASKED_ATTRIBUTES)
            if knows_kitty and (asked := ASKED_KITTY.search(sent, answered)):
                os.write(ours, b"\x1b_Gi=%s;OK\x1b\\" % asked[1])
                answered = asked.end()
        assert child.wait(10) == 0
    finally:
        child.kill()
        child.wait()
        os.close(ours)
    return sent.decode().split(END.decode())[:-1]


def pictures_in(sent: str) -> Iterator[np.ndarray]:
    payload = ""
    for options, part in re.findall(r"\x1b_G([^;\x1b]*);?([^\x1b]*)\x1b\\", sent):
        if "f=100" in options:
            payload += part
            if "m=0" in options:
                yield cv2.imdecode(np.frombuffer(base64.b64decode(payload), np.uint8), cv2.IMREAD_GRAYSCALE)
                payload = ""


@pytest.fixture(scope="module")
def sent_to_each() -> list[str]:
    return sent_to(KITTY, XTERM, WEZTERM, MUTE)


def test_any_other_terminal_gets_glyphs(sent_to_each: list[str]) -> None:
    for sent in sent_to_each[1:]:
        assert GLYPHS.search(sent)
        assert PLACEHOLDER not in sent
        assert not list(pictures_in(sent))


LEFT_BY_THE_QUERIES = """
import os, select, tty
from capture_app.tui.widgets.picture import find_sharp_terminal
tty.setcbreak(0)
os.write(1, b"<READY>")
found = find_sharp_terminal("local", {})
left = os.read(0, 99) if select.select([0], [], [], 0.5)[0] else b""
os.write(1, b"<%r %r>" % (found, left))
"""


def test_an_answer_that_comes_late_presses_no_key() -> None:
    ours, theirs = pty.openpty()
    child = subprocess.Popen(
        [sys.executable, "-c", LEFT_BY_THE_QUERIES],
        stdin=theirs,
        stdout=theirs,
        cwd=ROOT,
        start_new_session=True,
    )
    os.close(theirs)
    sent, answered = b"", 0
    try:
        for sent in received_from(ours):
            for asked, answer in ((ASKED_ATTRIBUTES, XTERM[0]), (b"\x1b[5n", b"\x1b[0n")):
                if asked in sent[answered:]:
                    time.sleep(0.3)  # a busy machine, or a slow link
                    os.write(ours, answer)
                    answered = sent.index(asked, answered) + len(asked)
    finally:
        child.kill()
        child.wait()
        os.close(ours)
    assert sent.endswith(b"<None b''>"), sent


def test_who_wants_glyphs_is_asked_nothing() -> None:
    (sent,) = sent_to(KITTY, choice="glyphs")
    assert not ASKED_KITTY.search(sent.encode())
    assert GLYPHS.search(sent)
    assert PLACEHOLDER not in sent


class SharpApp(App[None]):
    sharp_terminal = SharpTerminal(Sent, (10, 20))


async def test_a_picture_is_sharp_while_it_rests_and_is_let_go() -> None:
    app = SharpApp()
    async with app.run_test(size=(80, 24)) as pilot:
        sheet = TakeSheet.open(SAMPLE)
        look = LookScreen(sheet, sheet.cameras[0], 0)
        app.push_screen(look)

        def seen() -> str:
            picture = look.query_one(Picture)
            return "".join(picture.render_line(y).text for y in range(picture.size.height))

        await until(pilot, lambda: PLACEHOLDER in seen())
        await pilot.press("right")
        await pilot.press("right")
        await until(pilot, lambda: PLACEHOLDER in seen() and Sent.held == 1)
        await pilot.press("w")
        await until(pilot, lambda: GLYPHS.search(seen()) and Sent.held == 0)
        await pilot.press("w")
        await until(pilot, lambda: PLACEHOLDER in seen())
        await pilot.resize_terminal(60, 20)
        await finish_work(pilot)
        await until(pilot, lambda: PLACEHOLDER in seen())
        await pilot.press("escape")
        await until(pilot, lambda: Sent.held == 0)
