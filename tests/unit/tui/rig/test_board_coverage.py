"""The coverage of a calibration board, live: it is counted from the rig's previews."""

import cv2

from capture_app.board.boards import DEFAULT_BOARD
from tests.unit.tui.driving import lines, make_app, running, text, until
from tests.unit.tui.fake_rig import FakeRig


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
