"""Rigs of this machine by their records, and what a rig that does not start has said."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from capture_app.common import system
from capture_app.common.address import Address
from capture_app.common.errors import DiskFullError, NetworkError, NotAvailableError, SimulshotError
from capture_app.common.pairing_codes import Role
from capture_app.common.passwords import VARIABLE
from capture_app.common.stagger import Stagger
from capture_app.protocol.orders import AddCamera
from capture_app.rig import process
from capture_app.rig.membership import needs_pairing
from capture_app.rig.process import (
    LeaderRecord,
    attach,
    find_rig,
    list_rigs,
    recorded_rig,
    rigs_folder,
    start_rig,
)
from capture_app.trust.trust import Trust
from tests.cheap_rig import rig_of, start_leader
from tests.waiting import until

NOWHERE = Address("127.0.0.1", 1)


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Records and logs of this test alone."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"


def note(pid: int, port: int, sessions: Path, *, started_ns: int) -> Path:
    """Store the record of a rig."""
    path = rigs_folder() / f"{pid}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    rig = LeaderRecord(
        pid=pid, leader=f"127.0.0.1:{port}", sessions=str(sessions), started_unix_ns=started_ns
    )
    path.write_bytes(msgspec.json.encode(rig))
    return path


def ports(**which: Path | int) -> list[int]:
    return [rig.address.port for rig in list_rigs(**which)]  # type: ignore[arg-type]


def test_rigs_that_run_are_listed_newest_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as child:
        child.wait()
    ended = note(child.pid, 1000, tmp_path, started_ns=9)
    note(os.getpid(), 1001, tmp_path / "a", started_ns=1)
    note(os.getppid(), 1002, tmp_path / "b", started_ns=2)
    damaged = rigs_folder() / "7.json"
    damaged.write_text("{")
    assert ports() == [1002, 1001]
    assert (ended.exists(), damaged.exists()) == (False, True)
    assert ports(port=1001) == ports(sessions=tmp_path / "b" / ".." / "a") == [1001]
    assert ports(port=0) == [1002, 1001]
    assert ports(port=1001, sessions=tmp_path / "b") == []

    def refuse(pid: int, signal: int) -> None:
        raise PermissionError(f"{pid} {signal}")

    monkeypatch.setattr(os, "kill", refuse)
    assert ports() == [1002, 1001], "another user's runs, too"


async def test_a_rig_is_found_while_it_answers_and_is_recorded(tmp_path: Path) -> None:
    async with rig_of(0, tmp_path) as leader:
        with recorded_rig(leader.own_address, tmp_path):
            note(os.getppid(), NOWHERE.port, tmp_path, started_ns=2**62)
            rig = await find_rig()
            assert rig is not None
            assert (rig.address, rig.pid) == (leader.own_address, os.getpid())
        assert await find_rig() is None


def test_a_rig_runs_where_its_record_cannot_be_stored(tmp_path: Path, state: Path) -> None:
    state.write_text("in the way")
    with recorded_rig(NOWHERE, tmp_path):
        assert list_rigs() == []


async def test_a_screen_shows_the_rig_that_runs_and_adds_its_cameras(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[tuple[Address, object]] = []

    async def give(leader: Address, order: object) -> None:
        given.append((leader, order))

    monkeypatch.setattr(process, "give_order", give)
    monkeypatch.setenv(VARIABLE, "secret")
    async with rig_of(0, tmp_path) as leader:
        with recorded_rig(leader.own_address, tmp_path):
            rig = await attach(cameras=["rtsp://ann@10.0.0.9/a"])
        assert (rig.leader, rig.sessions, rig.is_local, rig.started) == (
            leader.own_address, tmp_path, True, False
        )  # fmt: skip
        assert given == [(leader.own_address, AddCamera(spec="rtsp://ann:secret@10.0.0.9/a"))]
        assert (await attach(leader=leader.own_address)).sessions == tmp_path
    # One that is given need not answer yet.
    for sessions, folder in ((None, Path("sessions")), (tmp_path, tmp_path)):
        rig = await attach(leader=NOWHERE, sessions=sessions)
        assert (rig.sessions, rig.is_local) == (folder, True)
    assert not (await attach(leader=Address("192.0.2.1", 1))).is_local


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Let a shell script be what a rig starts."""

    def replace(script: str) -> None:
        path = tmp_path / "program"
        path.write_text(f"#!/bin/sh\n{script}\n")
        path.chmod(0o755)
        monkeypatch.setattr(system, "PYTHON", (str(path),))

    return replace


@pytest.mark.parametrize(
    ("script", "kind", "says"),
    [
        ("echo 'leader: error: no room'; echo more; exit 6", NotAvailableError, "no room"),
        ("echo first; echo last; exit 9", SimulshotError, "the rig ended with code 9: last"),
        ("exit 9", SimulshotError, "the rig ended with code 9: it said nothing"),
    ],
)
async def test_a_rig_that_does_not_start_says_why(
    tmp_path: Path, program: Callable[[str], None], script: str, kind: type[SimulshotError], says: str
) -> None:
    program(script)
    with pytest.raises(kind, match=says):
        await start_rig(sessions=tmp_path, host="127.0.0.1")


async def test_a_rig_that_a_full_disk_keeps_silent_says_so(
    tmp_path: Path, program: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    program("exit 1")
    monkeypatch.setattr("capture_app.rig.process.free_bytes", lambda _: 1 << 10)
    with pytest.raises(DiskFullError, match=r"could not begin: the disk of .* is full"):
        await start_rig(sessions=tmp_path, host="127.0.0.1")


async def test_a_rig_is_started_as_asked_and_old_logs_go(
    tmp_path: Path, program: Callable[[str], None]
) -> None:
    rigs_folder().mkdir(parents=True)
    for number in range(12):
        (rigs_folder() / f"{number:02d}.log").touch()
    program('cat; echo "x: error: $*"; exit 1')
    with pytest.raises(SimulshotError) as caught:
        await start_rig(
            sessions=tmp_path, host="127.0.0.1", port=7, cameras=["a", "b"], stagger=Stagger.parse("even"),
            until_unused=True,
        )  # fmt: skip
    given = "--host 127.0.0.1 --port 7 --until-unused --camera=a --camera=b --stagger even"
    assert caught.value.what.endswith(given)
    assert f"leader --sessions {tmp_path} --log" in caught.value.what
    assert "--until-eof" not in caught.value.what, "it outlives this process"
    logs = sorted(path.name for path in rigs_folder().glob("*.log"))
    assert (len(logs), logs[0]) == (10, "03.log")


async def test_a_rig_that_does_not_answer_is_ended(
    tmp_path: Path, program: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "RIG_START_TIMEOUT_S", 0.2)
    program('echo $$ >"$0.pid"; exec sleep 60')
    with pytest.raises(NetworkError, match="did not answer within"):
        await start_rig(sessions=tmp_path, host="127.0.0.1")
    pid = int((tmp_path / "program.pid").read_text())
    await until(lambda: not Path(f"/proc/{pid}").exists())


async def test_a_machine_needs_pairing_until_the_leader_knows_it(tmp_path: Path) -> None:
    trust, own = Trust(tmp_path / "leader"), Trust(tmp_path / "own")
    async with await start_leader(tmp_path / "sessions", trust=trust) as leader:
        with own.in_use():
            assert await needs_pairing(leader.own_address)
            own.known.add(trust.identity.pin, Role.LEADER)
            assert await needs_pairing(leader.own_address), "its pin is not known there"
            trust.known.add(own.identity.pin, Role.OPERATOR)
            assert not await needs_pairing(leader.own_address)
    with own.in_use():
        assert not await needs_pairing(leader.own_address), "nobody answers"
