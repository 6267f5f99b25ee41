"""A paired machine that means harm: what it says as another one's camera, over real UDP and TLS."""

import asyncio
import hashlib
import socket
from collections.abc import Sequence
from typing import Any

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError
from capture_app.net.channel import Channel, connect
from capture_app.net.udp import client_socket
from capture_app.protocol import messages as wire
from capture_app.protocol.messages import FromLeader, KeyRequest, NodeStream, Refusal
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import CameraRecord, ImageRecord, image_path
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.datagrams import Hello, JoinRefusal, TimeRequest, Welcome
from capture_app.trust.datagram_keys import LeaderKeys
from capture_app.trust.trust import Trust
from tests.facts import make_facts
from tests.images import small_jpeg

FORGERY = small_jpeg(b"a picture that the thief has made")


async def ask(channel: Channel[Any], message: Any, *payload: bytes) -> Any:
    """The answer on a stream; None where it is broken off."""
    try:
        await channel.send(message, *payload)
        async with asyncio.timeout(20):
            return await channel.receive_header()
    except (NetworkError, TimeoutError):
        return None


async def say_hello(
    leader: Address, trust: Trust, name: str, instance: int, *, silence_s: float = 5.0
) -> Welcome | JoinRefusal | None:
    """Ask to join under a name, with a key for it, and confirm where that is granted; None for no answer."""
    loop = asyncio.get_running_loop()
    keys = LeaderKeys()
    async with await connect(leader, FromLeader, trust=trust) as channel:
        answer = await ask(channel, KeyRequest(name=name, instance=instance))
    if not isinstance(answer, wire.KeyAnswer):
        return None
    keys.hold(leader, answer.grant)
    with client_socket(socket.AF_INET) as sock:
        ends_s = loop.time() + silence_s
        while loop.time() < ends_s:
            data = keys.seal(encode(Hello(name, instance, make_facts())), leader)
            await loop.sock_sendto(sock, data or b"", tuple(leader))
            try:
                async with asyncio.timeout(0.5):
                    said = decode(keys.open(await loop.sock_recv(sock, 2048), leader))
            except TimeoutError:
                continue
            if isinstance(said, JoinRefusal):
                return said
            if isinstance(said, Welcome):
                data = keys.seal(encode(TimeRequest(said.client, 0, 0)), leader)
                await loop.sock_sendto(sock, data or b"", tuple(leader))
                return said
    return None


def report(camera: str, run: int, burst: int, instants: Sequence[int]) -> wire.CameraReport:
    """What a node would tell of such a burst."""
    record = CameraRecord(name=camera, facts=make_facts())
    plan = CameraPlan(camera=record, reported=True, instants=tuple(instants))
    return wire.CameraReport(leader=run, burst=burst, plan=plan)


def image(camera: str, run: int, burst: int, instant: int, data: bytes = FORGERY) -> wire.ImageBatch:
    """The message with a picture of that burst."""
    record = ImageRecord(
        camera=camera,
        instant=instant,
        path=image_path(camera, instant),
        leader_ns=instant,
        bytes=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
    )
    return wire.ImageBatch(images=(wire.ImageUpload(leader=run, burst=burst, record=record),))


async def bring(
    leader: Address,
    trust: Trust,
    node: tuple[str, int],
    burst: tuple[int, int],
    instants: Sequence[int],
    data: bytes = FORGERY,
) -> list[Any]:
    """Open a stream as that node and bring these pictures of a burst; the answers to all of it."""
    name, instance = node
    async with await connect(leader, FromLeader, trust=trust) as channel:
        answers = [await ask(channel, NodeStream(camera=name, instance=instance))]
        answers.append(await ask(channel, report(name, *burst, instants)))
        for instant in instants:
            answers.append(await ask(channel, image(name, *burst, instant, data), data))
    return answers


def granted(answers: Sequence[Any]) -> list[Any]:
    """Those of the answers that are no refusal, and more than a broken stream."""
    return [one for one in answers if one is not None and not isinstance(one, Refusal)]
