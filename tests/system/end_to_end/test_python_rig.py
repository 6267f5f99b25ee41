"""A rig from Python: started or joined, and nothing of it is left when its block ends."""

import asyncio
import sys
from pathlib import Path

import pytest

from capture_app import AsyncRig, Rig
from capture_app.common.errors import BadInputError, IncompleteError, NetworkError, NotAvailableError
from capture_app.rig.process import list_rigs
from tests.waiting import time_limit, until


def test_a_rig_takes_bursts_and_is_gone_afterwards(tmp_path: Path) -> None:
    with Rig(cameras=("sim:perfect,scene=bars",), sessions=tmp_path) as rig:
        with pytest.raises(IncompleteError, match="1 of 2 cameras are ready after 3 s"):
            rig.wait_until_ready(2, timeout_s=3)
        assert [node.state for node in rig.wait_until_ready(1).nodes] == ["ready"]
        session = rig.burst(2, name="jump", note="from Python")
        assert (session.name, session.manifest.note, len(session.instants)) == ("jump-001", "from Python", 2)
        assert session.instants[1].rgb().ndim == 4
        assert asyncio.run(_join(str(rig.address))) == [node.name for node in rig.status().nodes]
        assert len(list_rigs()) == 1
    assert list_rigs() == []
    with pytest.raises(NotAvailableError, match="not running"):
        rig.status()


async def _join(leader: str) -> list[str]:
    async with AsyncRig(leader) as joined:
        # A notebook has a loop of its own, in which the calls that wait must work, too.
        with Rig(leader) as waiting:
            assert waiting.address == joined.address
            return [node.name for node in waiting.status().nodes]


def test_a_rig_that_cannot_be_had_leaves_nothing_behind(tmp_path: Path) -> None:
    with (
        pytest.raises(BadInputError, match="no simulated scene"),
        Rig(simulated=1, scene="x", sessions=tmp_path),
    ):
        pass
    assert list_rigs() == []
    with pytest.raises(NetworkError), Rig("127.0.0.1:9"):
        pass
    for leader, cameras in (("127.0.0.1", 1), ("", 0)):
        with pytest.raises(BadInputError):
            Rig(leader, simulated=cameras)


async def test_a_killed_script_leaves_no_rig_behind(tmp_path: Path) -> None:
    script = (
        "import time\nfrom capture_app import Rig\n"
        f"with Rig(sessions={str(tmp_path)!r}) as rig:\n"
        "    print(rig.address, flush=True)\n    time.sleep(600)\n"
    )
    owner = await asyncio.create_subprocess_exec(sys.executable, "-c", script, stdout=asyncio.subprocess.PIPE)
    assert owner.stdout is not None
    async with time_limit("the script's rig"):
        assert await owner.stdout.readline()
    assert len(list_rigs()) == 1
    owner.kill()
    await owner.wait()
    await until(lambda: list_rigs() == [])
