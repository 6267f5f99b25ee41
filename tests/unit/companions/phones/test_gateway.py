"""Phones that come, take part, go and come back, over real TLS and sockets, without a browser."""

import asyncio
import contextlib
import ssl
from collections.abc import AsyncIterator
from pathlib import Path
from urllib.parse import urlsplit

import aiohttp
import pytest

from capture_app.common.camera_facts import MICROSECONDS, CameraControls, Control, ControlValue
from capture_app.common.errors import SimulshotError
from capture_app.common.node_state import NodeState
from capture_app.companions.phones.gateway import REPLACED
from capture_app.protocol.orders import ControlsAnswer, ControlsRequest, RemoveCamera
from capture_app.rig.rig_link import ask_leader, give_order
from capture_app.web import paired_page
from capture_app.web.paired_page import MAX_GREETED, MAX_UNKNOWN
from tests.unit.companions.phones.places import Place, burst, serving
from tests.waiting import time_limit, until


@pytest.fixture
async def place(tmp_path: Path) -> AsyncIterator[Place]:
    async with serving(tmp_path) as place:
        yield place


async def test_controls_are_set_by_the_page_and_told(place: Place) -> None:
    phone = await place.phone()
    await phone.join()
    await phone.open_camera()
    await until(lambda: place.state("left") not in (None, NodeState.FAILED))
    leader = place.leader.own_address

    async def controls(**wanted: float) -> CameraControls:
        async with time_limit("the controls of the camera"):
            while True:
                with contextlib.suppress(SimulshotError):  # its viewfinder may not be open yet
                    values: dict[Control, ControlValue] = {Control(name): wanted[name] for name in wanted}
                    request = ControlsRequest(camera="left", values=values)
                    return (await ask_leader(leader, request, ControlsAnswer)).state
                await asyncio.sleep(0.05)

    told = (await controls()).state(Control.EXPOSURE)
    assert told is not None
    assert (told.value, told.unit) == (20_000.0, MICROSECONDS)
    answer = await controls(exposure=4_000.0)
    assert answer.problems == {}
    assert phone.exposure_us == 4_000.0
    refused = await controls(exposure=1e9)
    assert "the browser refuses it" in refused.problems[Control.EXPOSURE]
    (image,) = (await burst(place, 1)).manifest.images
    assert image.exposure_ns == 4_000_000


async def test_a_phone_that_an_operator_puts_off_stays_off(place: Place) -> None:
    phone = await place.phone()
    await phone.join()
    await phone.open_camera()
    await until(lambda: place.state("left") not in (None, NodeState.FAILED))
    async with time_limit("the order to put it off"):
        while place.state("left") is not None:
            with contextlib.suppress(SimulshotError):  # its viewfinder may not be open yet
                await give_order(place.leader.own_address, RemoveCamera(name="left"))
            await asyncio.sleep(0.05)
    status, body = await phone.ask()
    assert (status, "has removed this phone" in body["words"]) == (403, True)
    again = await place.phone(key=phone.key)
    assert await again.join() == "left"


async def test_who_has_no_secret_gets_nothing(place: Place) -> None:
    stranger = await place.phone()
    assert (await stranger.ask(secret="guess"))[0] == 403
    status, body = await stranger.ask(secret="")
    assert status == 403
    assert "scan the code" in body["words"]
    async with aiohttp.ClientSession() as session:
        with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
            await session.ws_connect(f"{place.base}link/guess", ssl=False)
        other = {"Origin": "https://elsewhere.example"}
        async with session.get(place.base, headers=other, ssl=False) as answer:
            assert answer.status == 403
        # A name of the attacker's that resolves to this machine, for both headers.
        rebound = {"Host": "rebound.example", "Origin": "https://rebound.example"}
        async with session.get(place.base, headers=rebound, ssl=False) as answer:
            assert answer.status == 403
        async with session.post(f"{place.base}join", data=b"x" * 5000, ssl=False) as answer:
            assert answer.status == 413
        async with session.post(f"{place.base}join", data=b"[]", ssl=False) as answer:
            assert answer.status == 400


@pytest.mark.parametrize(
    ("headers", "body", "status"),
    [
        ("Origin: http://[", b"", 403),
        ("X: " + "a" * 20_000, b"", 400),
        ("Content-Encoding: gzip", b"no gzip", 400),
        ("Transfer-Encoding: chunked", b"ZZ\r\n", 400),
        ("X: y", b'{"secret": "", "key": "", "more": ' + b"[" * 3000, 400),
    ],
    ids=["origin", "long", "gzip", "chunks", "deep"],
)
async def test_what_strangers_send_is_refused_without_a_traceback(
    place: Place, caplog: pytest.LogCaptureFixture, headers: str, body: bytes, status: int
) -> None:
    trusting = ssl.create_default_context()
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    reader, writer = await asyncio.open_connection("127.0.0.1", urlsplit(place.base).port, ssl=trusting)
    length = "" if "chunked" in headers else f"Content-Length: {len(body)}\r\n"
    head = f"POST /join HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{length}{headers}\r\n\r\n"
    writer.write(head.encode() + body)
    async with time_limit("the server's answer"):
        assert (await reader.read()).split()[1] == str(status).encode()
    writer.close()
    assert [record.getMessage() for record in caplog.records if record.exc_info] == []


async def test_a_phone_that_talks_nonsense_is_cut_off_alone(place: Place) -> None:
    good = await place.phone()
    assert await good.join() == "left"
    await good.open_camera()
    bad = await place.phone(name="bad")
    await bad.join()
    await bad.say(type="order", what="stop")
    await until(lambda: bad.is_cut_off)
    await until(lambda: place.state("left") not in (None, NodeState.FAILED))


@pytest.mark.parametrize(
    "first",
    [b"no words", "[" * 100_000, '{"type": "page-hidden", "why": "x"}', None],
    ids=["bytes", "deep", "away", "close"],
)
async def test_a_link_that_does_not_begin_with_a_hello_is_closed(
    place: Place, caplog: pytest.LogCaptureFixture, first: bytes | str | None
) -> None:
    phone = await place.phone()
    link = await phone.link()
    if first is None:
        await link.close()
    else:
        await (link.send_bytes(first) if isinstance(first, bytes) else link.send_str(first))
        async with time_limit("the end of the link"):
            await link.receive()
        assert link.close_code == 1003
    assert [record.getMessage() for record in caplog.records if record.exc_info] == []


async def test_the_page_that_came_last_is_the_phones(place: Place) -> None:
    first = await place.phone()
    await first.join()
    await first.open_camera()
    second = await place.phone(key=first.key, zero_us=9e9)
    assert await second.join() == "left"
    await second.open_camera()
    await until(lambda: first.is_cut_off)
    assert first.close_code == REPLACED
    await until(lambda: place.state("left") not in (None, NodeState.FAILED))
    assert not second.is_cut_off


async def test_the_page_is_isolated_and_runs_its_own_scripts_only(place: Place) -> None:
    async with aiohttp.ClientSession() as session:
        for part, kind in (("", "text/html"), ("link.js", "text/javascript"), ("page.css", "text/css")):
            async with session.get(place.base + part, ssl=False) as answer:
                assert answer.status == 200
                assert answer.content_type == kind
                assert answer.headers["Cross-Origin-Opener-Policy"] == "same-origin"
                assert answer.headers["Cross-Origin-Embedder-Policy"] == "require-corp"
                assert "default-src 'none'; script-src 'self';" in answer.headers["Content-Security-Policy"]
        async with session.get(f"{place.base}../pyproject.toml", ssl=False) as answer:
            assert answer.status == 404


async def test_two_phones_by_one_code_are_one_and_a_refusal(place: Place) -> None:
    first = await place.phone()
    second = await place.phone()
    assert first.secret == second.secret
    assert await first.join() == "left"
    status, body = await second.ask()
    assert status == 403
    assert "Another phone has used" in body["words"]
    second.secret = place.admission.secret
    assert await second.join() == "left-2"


async def test_idle_connections_are_counted_when_they_are_accepted(place: Place) -> None:
    """4,000 of them took 320 MB before any had spoken TLS."""
    where = urlsplit(place.url)
    idle = [await asyncio.open_connection(where.hostname, where.port) for _ in range(3 * MAX_GREETED)]
    ended = [asyncio.create_task(reader.read()) for reader, _ in idle]
    await until(lambda: sum(task.done() for task in ended) >= 2 * MAX_GREETED)
    phone = await place.phone()
    assert await phone.join() == "left", "whoever speaks is let in"
    for task, (_, writer) in zip(ended, idle, strict=True):
        task.cancel()
        writer.transport.abort()


async def test_idle_connections_that_speak_tls_are_counted_as_they_come(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They were counted twice a second: 4,000 of them took 346 MB."""
    monkeypatch.setattr(paired_page, "LOOK_EVERY_S", 1e6)
    where, tls = urlsplit(place.url), ssl.create_default_context()
    tls.check_hostname, tls.verify_mode = False, ssl.CERT_NONE
    idle = []
    for _ in range(MAX_UNKNOWN + 20):
        idle.append(await asyncio.open_connection(where.hostname, where.port, ssl=tls))
    await until(lambda: sum(reader.at_eof() for reader, _ in idle) >= 20)
    assert sum(not reader.at_eof() for reader, _ in idle) <= MAX_UNKNOWN
    phone = await place.phone()
    assert await phone.join() == "left", "whoever speaks is let in"
    for _, writer in idle:
        writer.transport.abort()


async def test_no_answer_tells_which_program_serves_it(place: Place) -> None:
    async with (
        aiohttp.ClientSession(connector=aiohttp.TCPConnector(ssl=False)) as session,
        session.get(place.url.partition("#")[0]) as page,
    ):
        assert page.status == 200
        assert "Server" not in page.headers
