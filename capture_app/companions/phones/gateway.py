"""Web server for phones: the page, their admission, and one link for each phone."""

import functools
from collections.abc import Callable
from pathlib import Path

from aiohttp import WSMsgType, web

from capture_app.common.host_clock import host_ns
from capture_app.companions.phones import wire
from capture_app.companions.phones.phone import Phone
from capture_app.web.admission import Admission, Admitted
from capture_app.web.paired_page import PageLink, PairedPage

DEFAULT_SIZE = (1280, 720)
HELLO_S = 10.0
LEFT = 1000
"""Close code of a page whose user ends its link."""
REPLACED = 4001
"""Close code for a page that another page of the same phone replaces."""


class PhoneGateway(PairedPage):
    """Serves the page and its links; `on_phone` decides how a phone's frames are used."""

    max_message_bytes = wire.MAX_PICTURE_BYTES

    def __init__(
        self,
        admission: Admission,
        on_phone: Callable[[Phone], None],
        size: tuple[int, int] = DEFAULT_SIZE,
        *,
        sound: bool = False,
    ) -> None:
        """Create the gateway; `on_phone` is called once for each phone, when its page first connects.

        `size` is the width and height in pixels that phones are asked for; `sound`: they are asked for their
        microphones, too.
        """
        values = {"size": "{}x{}".format(*size), "sound": "yes" if sound else ""}
        super().__init__(admission, Path(__file__).parent / "page", values)
        self._on_phone = on_phone
        self._phones: dict[str, Phone] = {}
        self._link_of: dict[str, PageLink] = {}
        """Current link of each phone, by its key."""

    async def serve_link(self, link: PageLink) -> None:
        """Pass a page's messages to its phone; a newer page of the same phone replaces this one."""
        hello, admitted = await _hello(link.socket), link.admitted
        # Two pages would report two different clocks.
        self._end_link(admitted, b"This phone takes part by another page of it. Close one of them.")
        self._link_of[admitted.key] = link
        phone, send = self._phones.get(admitted.key), link.send
        if phone is None:
            phone = self._phones[admitted.key] = Phone(admitted.name, host_ns, hello)
            phone.put_off = functools.partial(self._put_off, admitted)
            self._on_phone(phone)
        phone.link_opened(send, hello)
        try:
            async for message in link.socket:
                received_ns = link.connection.received_ns
                if message.type is WSMsgType.BINARY:
                    report = wire.decode_binary(message.data)
                    if isinstance(report, wire.Ping):
                        phone.clock.note_pong(report, received_ns, host_ns())
                        await send(wire.pong(report.number))
                    phone.take_binary(report, received_ns)
                elif message.type is WSMsgType.TEXT:
                    said = wire.decode_text(message.data)
                    if isinstance(said, wire.PhoneHello):
                        raise ValueError("a second hello")
                    phone.take_text(said)
        finally:
            phone.link_closed(send, by_user=link.socket.close_code == LEFT)

    def _put_off(self, admitted: Admitted) -> None:
        self.admission.put_off(admitted)
        if (phone := self._phones.pop(admitted.key, None)) is not None:
            phone.said_goodbye = True
        reason = b"The leader has put this phone off. To come back, scan the code that it shows now."
        self._end_link(admitted, reason)

    def _end_link(self, admitted: Admitted, reason: bytes) -> None:
        if (link := self._link_of.get(admitted.key)) is not None:
            link.end(REPLACED, reason)


async def _hello(link: web.WebSocketResponse) -> wire.PhoneHello:
    first = await link.receive(timeout=HELLO_S)
    hello = wire.decode_text(first.data) if first.type is WSMsgType.TEXT else None
    if not isinstance(hello, wire.PhoneHello):
        raise ValueError("a page must begin with its hello")
    return hello
