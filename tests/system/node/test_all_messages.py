"""Every message of a stream, by whoever should not send it: a stranger, a camera, an operator; and again."""

from pathlib import Path

import pytest
from msgspec import inspect

from benchmarks.endurance.field_attacks import attacks, example
from capture_app.net.channel import connect
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.protocol import messages as wire
from capture_app.protocol.messages import FromLeader
from capture_app.trust.trust import Trust
from tests.unit.node.joining import joined
from tests.unit.node.sealed_nodes import introduced
from tests.unit.node.test_all_messages import (
    answer,
    leader,  # noqa: F401 - a fixture
)
from tests.waiting import until

pytestmark = pytest.mark.virtual


async def test_a_camera_with_any_field_changed_harms_nobody(
    tmp_path: Path, leader: LeaderNode, trust: Trust
) -> None:
    """On the stream of its own node: each is refused, and the stream and the others go on."""
    machine, sent = introduced(tmp_path, trust, "machine"), 0
    async with (
        joined(leader.own_address, ("cam1", 1), trust=machine),
        await connect(leader.own_address, FromLeader, trust=machine) as channel,
    ):
        await until(lambda: bool(leader.status().nodes))
        opened = wire.NodeStream(camera="cam1", instance=1)
        await channel.send(opened)
        assert isinstance(await channel.receive_header(), wire.ReportAck)
        for kind in (wire.CameraReport, wire.ImageBatch, wire.SpoolSpace):
            info = inspect.type_info(kind)
            for path, plain in attacks(info, example(info)):
                await channel.send(plain)
                said = await channel.receive_header()
                assert isinstance(said, wire.Refusal | wire.ReportAck), (kind, path, said)
                sent += 1
        assert isinstance(await answer(leader, trust, wire.StatusRequest()), wire.StatusAnswer)
        assert len(leader.log.after(0)) < 100
    assert sent > 2000
