"""A staggered rig of real nodes in virtual time: what its session says, and what is made of it."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from capture_app.common.stagger import Stagger
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.protocol.messages import BurstRequest
from capture_app.session.reading.verify import verify
from tests.cheap_rig import ready_rig, take_session

pytestmark = pytest.mark.virtual
NAMES = tuple(f"cam{number}" for number in range(4))
STEP_NS = 8_333_250


@pytest.fixture
async def leader(tmp_path: Path) -> AsyncIterator[LeaderNode]:
    options = LeaderOptions(sessions=tmp_path / "sessions", host="127.0.0.1", port=0, stagger=Stagger())
    async with ready_rig(options, NAMES) as leader:
        yield leader


async def test_a_wrong_delay_in_a_manifest_is_found(leader: LeaderNode) -> None:
    session = await take_session(leader, BurstRequest(frames=2))
    first, *others = session.manifest.cameras
    wrong = replace(session.stored_manifest, cameras=(replace(first, delay_ns=STEP_NS), *others))
    problems = verify(type(session)(session.folder, wrong))
    assert any("residual_ns" in str(problem) for problem in problems)
