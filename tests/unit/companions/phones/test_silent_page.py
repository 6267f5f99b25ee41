"""A page whose frames are of no use to a burst is reported within ten seconds."""

from dataclasses import dataclass

import pytest

from capture_app.common.errors import CameraError
from capture_app.companions.phones.phone import Phone
from capture_app.companions.phones.wire import FrameReport, Opened, PhoneHello, Ping

PERIOD_US = 33_333.0
MS = 1_000_000


@dataclass
class Page:
    """A page whose clock is the gateway's, and whose media times run at another rate."""

    media_rate: float

    def __post_init__(self) -> None:
        self.now_ns = 10**12
        self.phone = Phone("phone", lambda: self.now_ns, PhoneHello(page="p", resolution_us=5.0))
        for number in range(310):
            self.now_ns += MS
            now_us = self.now_ns / 1e3
            self.phone.take_binary(Ping(number, number - 1 if number else None, now_us, now_us), self.now_ns)
            self.phone.clock.note_pong(Ping(number, None, now_us, now_us), self.now_ns, self.now_ns)
        self.phone.take_text(Opened(width=640, height=480, frame_rate=30.0))
        self.frames, self.opened_ns = 0, self.now_ns

    def show(self, seconds: float) -> None:
        """Let the camera run."""
        for _ in range(round(seconds * 30)):
            self.now_ns += round(PERIOD_US * 1e3)
            media_us = (self.now_ns - self.opened_ns) / 1e3 * self.media_rate
            self.phone.take_binary(
                FrameReport(self.frames, 1, media_us, self.now_ns / 1e3, None), self.now_ns
            )
            self.frames += 1


def test_a_page_with_frames_is_left_alone() -> None:
    page = Page(media_rate=1.0)
    page.show(12.0)
    page.phone.check_frames()
    assert page.phone.came.is_set()


def test_a_page_whose_frames_stop_is_reported_until_they_come_again() -> None:
    page = Page(media_rate=1.0)
    page.show(2.0)
    page.now_ns += 9_000 * MS
    with pytest.raises(CameraError, match="delivers no frame that can be used"):
        page.phone.check_frames()
    assert not page.phone.came.is_set()
    page.show(1.0)
    page.phone.check_frames()
    assert page.phone.came.is_set()


def test_a_page_whose_media_times_fall_behind_is_reported() -> None:
    """WebKit's media time counts frames: at a camera that loses some, it falls behind its clock."""
    page = Page(media_rate=0.9)
    page.show(20.0)
    with pytest.raises(CameraError, match="delivers no frame that can be used"):
        page.phone.check_frames()
