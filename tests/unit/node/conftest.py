"""A leader whose trust is kept in a folder of its own."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from capture_app.node.leader.leader_node import LeaderNode
from capture_app.trust.trust import Trust
from tests.cheap_rig import start_leader


@pytest.fixture
def trust(tmp_path: Path) -> Trust:
    return Trust(tmp_path / "leader")


@pytest.fixture
async def leader(tmp_path: Path, trust: Trust) -> AsyncIterator[LeaderNode]:
    async with await start_leader(tmp_path / "sessions", trust=trust) as node:
        yield node
