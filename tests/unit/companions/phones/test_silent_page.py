"""A phone whose page is silent, was loaded again, was replaced by another one, or restarts its camera."""

import json
from dataclasses import dataclass

import pytest

from capture_app.common.errors import CameraError
from capture_app.companions.phones.phone import Phone
from capture_app.companions.phones.phone_camera import PhoneCamera
from capture_app.companions.phones.wire import FrameReport, Opened, PhoneHello, Ping
from capture_app.sync.wire.camera_commands import RestartStream

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


HELLO = PhoneHello(page="p", resolution_us=5.0)


async def send(message: str | bytes) -> None:
    raise AssertionError(message)


async def send_nothing(_: str | bytes) -> None:
    pass


def test_a_page_that_another_one_has_replaced_disconnects_nobody() -> None:
    phone = Page(media_rate=1.0).phone
    phone.link_opened(send, HELLO)
    phone.link_opened(send_nothing, HELLO)
    phone.link_closed(send, by_user=True)
    assert (phone.back.is_set(), phone.closed.is_set(), phone.said_goodbye) == (True, False, False)
    phone.link_closed(send_nothing, by_user=True)
    assert (phone.back.is_set(), phone.closed.is_set(), phone.said_goodbye) == (False, True, True)


def test_a_page_that_was_loaded_again_has_another_clock() -> None:
    phone = Page(media_rate=1.0).phone
    clock = phone.clock
    phone.link_opened(send, HELLO)
    assert phone.clock is clock, "its link broke off"
    phone.link_opened(send, PhoneHello(page="q", resolution_us=5.0))
    assert not phone.clock.is_known


async def test_a_stream_restarts_after_the_delay_of_its_order() -> None:
    page, sent = Page(media_rate=1.0), list[str | bytes]()

    async def note(message: str | bytes) -> None:
        sent.append(message)

    page.phone.link_opened(note, HELLO)
    page.show(2.0)
    await PhoneCamera(page.phone).apply(RestartStream(delay_ns=70 * MS))
    (order,) = map(json.loads, sent)
    assert order["type"] == "restart"
    assert order["at_us"] == pytest.approx(page.now_ns / 1e3 + 70_000, abs=1000)
