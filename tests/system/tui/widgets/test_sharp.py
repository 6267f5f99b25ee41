"""Pictures in the terminal's own pixels: who gets them, and what is sent. The terminal is the test itself."""

import numpy as np

from tests.unit.tui.widgets.sent import PLACEHOLDER
from tests.unit.tui.widgets.test_sharp import (
    KITTY,
    pictures_in,
    sent_to,
    sent_to_each,  # noqa: F401 - a fixture
)


def test_kitty_gets_the_picture_with_a_pixel_for_each_of_its_own(sent_to_each: list[str]) -> None:
    sent = sent_to_each[0]
    (picture,) = pictures_in(sent)
    assert picture.shape == (12 * 16, 32 * 8)  # 64x48, in cells twice as high as wide
    assert abs(picture.mean(0) - np.linspace(0, 252, 256)).max() < 6
    assert sent.count(PLACEHOLDER) in (
        12 * 32,
        2 * 12 * 32,
    )  # once more where a late answer has all drawn again


def test_over_ssh_only_who_wants_it() -> None:
    remote = {"SSH_CONNECTION": "::1 1 ::1 22"}
    assert PLACEHOLDER in sent_to(KITTY, choice="sharp", **remote)[0]
    assert PLACEHOLDER not in sent_to(KITTY, **remote)[0]
