"""The coverage of a calibration board, live: it is counted from the rig's previews."""

import asyncio
from collections.abc import Sequence
from pathlib import Path

import cv2
import pytest

from capture_app.board.boards import DEFAULT_BOARD
from tests.unit.tui.driving import lines, make_app, running, text, until
from tests.unit.tui.fake_rig import FakeRig


async def test_a_board_to_print_is_written_and_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ordered: list[Sequence[str]] = []

    async def ask(arguments: Sequence[str], _: type[object]) -> None:
        ordered.append(arguments)
        await asyncio.to_thread(Path(arguments[1]).write_bytes, b"%PDF-1.4")

    monkeypatch.setattr("capture_app.tui.rig.rig_view.ask_reconstruct", ask)
    monkeypatch.setenv("SSH_TTY", "/dev/pts/0")
    app = make_app(FakeRig(2), sessions=tmp_path / "sessions")
    async with running(app) as pilot:
        await pilot.press("G")
        await until(pilot, lambda: app._notifications)
        page = tmp_path / "sessions" / "board.pdf"
        assert ordered == [("board", str(page))]
        assert [note.message for note in app._notifications] == [f"The file is on this machine:\n{page}"]


async def test_each_new_view_of_the_board_is_counted_at_once() -> None:
    rig = FakeRig(2)
    app = make_app(rig)
    async with running(app) as pilot:
        await pilot.press("K")
        await until(pilot, lambda: "cam01        0 views" in text(app, "#coverage-words"))
        assert max(map(len, lines(app, "#coverage-words"))) <= 74
        board = cv2.copyMakeBorder(
            DEFAULT_BOARD.picture(120), 120, 240, 120, 320, cv2.BORDER_CONSTANT, value=255
        )
        jpeg = cv2.imencode(".jpg", cv2.resize(board, None, fx=0.4, fy=0.4))[1].tobytes()
        rig.preview("cam00", jpeg, board.shape[1], board.shape[0])
        await until(pilot, lambda: "cam00        1 view," in text(app, "#coverage-words"))
        await pilot.press("escape")
        await until(pilot, lambda: app.screen.id != "coverage-guide")
