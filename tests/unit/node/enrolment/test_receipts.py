"""A node below a relay deletes its copy of an image only when the root, not the relay, has confirmed it."""

import asyncio
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from capture_app.common.pairing_codes import Role
from capture_app.net.channel import Channel, connect
from capture_app.node.camera.spool import Spool
from capture_app.node.camera.uploader import Uploader
from capture_app.node.enrolment import ask_to_enrol, pair
from capture_app.protocol.log import Log
from capture_app.protocol.messages import (
    CameraReport,
    FromLeader,
    ImageAck,
    ImageBatch,
    NodeStream,
    Refusal,
    ReportAck,
    ToLeader,
)
from capture_app.protocol.pairing_messages import Invite
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.trust.identity import is_proven, sign
from capture_app.trust.trust import Trust
from tests.cheap_rig import start_leader
from tests.images import small_jpeg
from tests.unit.net.echoes import serving
from tests.unit.node.camera.uploading import Picture, burst_upload, receipts_of
from tests.unit.node.enrolment.test_below_relays import ask, relays
from tests.unit.node.joining import joined
from tests.unit.node.sealed_nodes import introduced
from tests.unit.node.test_other_machines import seen
from tests.unit.node.thieves import image, report
from tests.waiting import until

pytestmark = pytest.mark.virtual

PICTURE = small_jpeg(b"the only copy")
CAMERA = ("a", 1)


def copies(folder: Path) -> list[bytes]:
    return [file.read_bytes() for file in folder.rglob("*.film")]


@pytest.mark.parametrize("lie", ["acknowledges", "has it already", "asks for none", "says it is cancelled"])
@pytest.mark.parametrize("signs", [False, True], ids=["unsigned", "signed by itself"])
async def test_a_relay_that_confirms_images_itself_has_none_deleted(
    tmp_path: Path, lie: str, signs: bool
) -> None:
    root, relay = Trust(tmp_path / "root"), Trust(tmp_path / "relay")
    node = introduced(tmp_path, relay, "node")
    node.known.add(relay.identity.pin, Role.LEADER, roots=(root.identity.pin,))
    answers: list[str] = []

    async def serve(channel: Channel[ToLeader]) -> None:
        while (said := await channel.receive_header()) is not None:
            _ = [chunk async for chunk in channel.payload()]
            answer: Any = ReportAck()
            if isinstance(said, CameraReport):
                answers.append(lie)
                if lie == "has it already":
                    answer = receipts_of({0: PICTURE})
                elif lie == "asks for none":
                    answer = ReportAck(requested=())
                elif lie == "says it is cancelled":
                    answer = Refusal(what="cancelled", forget=True)
                elif not signs:
                    answer = ReportAck(proof=sign(root.identity, ("a", 1, 1), ReportAck()))
            if isinstance(said, ImageBatch):
                answer = ImageAck(sha256=said.sha256)
            if signs and not isinstance(said, NodeStream):
                answer = replace(answer, proof=sign(relay.identity, ("a", 1, 1), answer))
            await channel.send(answer)

    lines: list[str] = []
    async with serving(serve, ToLeader, trust=relay) as address:
        spool = Spool(tmp_path, "spool")
        uploader = Uploader("a", 1, Log(lines.append), spool, retry_s=(0.01,), trust=node)
        uploader.load_spool()
        uploader.add_burst(burst_upload(Picture(PICTURE)))
        uploader.set_leader(address, 1)
        task = asyncio.create_task(uploader.run())
        await until(lambda: len(answers) > 3)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        spool.close()
    assert copies(tmp_path) == [PICTURE]
    assert any("without the signature of its rig's leader" in line for line in lines), lines


async def test_a_cancelled_burst_is_deleted_once_the_root_has_signed_that(tmp_path: Path) -> None:
    root, relay = Trust(tmp_path / "root"), Trust(tmp_path / "relay")
    node = introduced(tmp_path, relay, "node")
    node.known.add(relay.identity.pin, Role.LEADER, roots=(root.identity.pin,))
    arrived, is_cancelled = asyncio.Event(), asyncio.Event()

    async def serve(channel: Channel[ToLeader]) -> None:
        while (said := await channel.receive_header()) is not None:
            _ = [chunk async for chunk in channel.payload()]
            answer: ReportAck | Refusal = ReportAck()
            if isinstance(said, ImageBatch):
                arrived.set()
                await is_cancelled.wait()
                answer = Refusal(what="cancelled", forget=True)
            await channel.send(replace(answer, proof=sign(root.identity, ("a", 1, 1), answer)))

    async with serving(serve, ToLeader, trust=relay) as address:
        spool = Spool(tmp_path, "spool")
        uploader = Uploader("a", 1, Log(lambda _: None), spool, trust=node)
        uploader.load_spool()
        uploader.add_burst(burst_upload(Picture(PICTURE)))
        uploader.set_leader(address, 1)
        task = asyncio.create_task(uploader.run())
        await arrived.wait()
        uploader.cancel_burst(1, 1)
        await asyncio.sleep(0.1)
        assert copies(tmp_path) == [PICTURE], "a datagram of the relay alone deletes nothing"
        is_cancelled.set()
        await until(lambda: not copies(tmp_path))
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        spool.close()


@pytest.mark.parametrize("depth", [1, 2])
async def test_the_root_signs_its_answers_to_nodes_below_relays(tmp_path: Path, depth: int) -> None:
    async with relays(tmp_path, depth) as (leader, near, trust):
        node, pins = introduced(tmp_path, trust, "node"), [leader.options.trust.identity.pin]
        async with joined(near.address, CAMERA, trust=node):
            await seen(leader, "a")
            session = await leader.bursts.order(BurstOrder(frames=1))
            run, burst = leader.instance, session.burst.number
            async with await connect(near.address, FromLeader, trust=node) as channel:
                await ask(channel, NodeStream(camera="a", instance=1))
                acknowledged = await ask(channel, report("a", run, burst, [0]))
                await channel.send(image("a", run, burst, 0, PICTURE), PICTURE)
                stored = await channel.receive_header()
    for answer, kind in ((acknowledged, ReportAck), (stored, ImageAck)):
        assert isinstance(answer, kind), answer
        unsigned = replace(answer, proof=None)
        assert is_proven(answer.proof, pins, ("a", run, burst), unsigned)
        assert not is_proven(answer.proof, pins, ("a", run, burst + 1), unsigned), "of another burst"
        assert not is_proven(answer.proof, [trust.identity.pin], ("a", run, burst), unsigned)


async def test_a_node_that_pairs_with_a_relay_learns_whose_signature_it_needs(tmp_path: Path) -> None:
    async with relays(tmp_path, 1) as (leader, near, trust):
        node = Trust(tmp_path / "node")
        async with await connect(near.address, FromLeader, trust=trust) as channel:
            invited = await ask(channel, Invite())
        await pair(near.address, invited.code, node)
        assert node.roots_of(trust.identity.pin) == (leader.options.trust.identity.pin,)
        async with await start_leader(tmp_path / "s2", trust=trust) as new:
            await pair(new.own_address, new.enrolment.invite(Role.CAMERA).code, node)
        assert not node.roots_of(trust.identity.pin), "it is a leader itself now"


async def test_a_node_whose_pin_was_pasted_at_a_relay_learns_whose_signature_it_needs(tmp_path: Path) -> None:
    async with relays(tmp_path, 1) as (leader, near, trust):
        node = Trust(tmp_path / "node")
        node.known.add(trust.identity.pin, Role.LEADER)
        trust.known.add(node.identity.pin, Role.CAMERA)
        for _ in range(2):
            await ask_to_enrol(near.address, node)
            assert node.roots_of(trust.identity.pin) == (leader.options.trust.identity.pin,)
