"""The rig's time for an operator, and marks at it: within the bounds, in the session, for nobody else."""

import asyncio
import time
from pathlib import Path
from typing import Any

import pytest

from capture_app import open_session
from capture_app.common.errors import BadInputError, UnknownMachineError
from capture_app.common.host_clock import host_from_monotonic
from capture_app.common.pairing_codes import Role
from capture_app.net import channel
from capture_app.rig.rig_time import LeaderTime, place_mark, rig_time
from capture_app.session.format.marks import RIG_MARKS, Mark, marks_of
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.trust.trust import Trust
from tests.cheap_rig import rig_of, start_leader
from tests.unit.node.sealed_nodes import introduced
from tests.unit.session.recorded import record


async def test_the_leaders_clock_is_within_the_bounds(tmp_path: Path) -> None:
    """The leader's clock is this machine's, so the truth is known."""
    async with rig_of(0, tmp_path) as leader:
        for _ in range(5):
            now = await rig_time(leader.own_address)
            local_ns = host_from_monotonic(now.local_ns)
            assert now.earliest_ns <= local_ns <= now.latest_ns
            assert now.latest_ns - now.earliest_ns < 2e9
            assert abs(now.leader_ns - local_ns) <= now.uncertainty_ns
            assert abs(now.leader_ns + now.unix_less_leader_ns - time.time_ns()) < 60e9


def test_bounds_grow_away_from_their_moment_by_what_clocks_drift() -> None:
    now = LeaderTime(1_000_000, 1_000_100, 500, 7)
    for later_ns in (10**9, -(10**9)):
        later = now.at(500 + later_ns)
        for ppm in (-1010, 0, 1010):
            assert later.earliest_ns <= 1_000_050 + later_ns * (1 + ppm * 1e-6) <= later.latest_ns
        assert later.latest_ns - later.earliest_ns < 2_120_200
        assert later.unix_less_leader_ns == 7


async def test_without_a_take_it_is_beside_the_sessions(tmp_path: Path) -> None:
    async with rig_of(0, tmp_path / "sessions") as leader:
        address = leader.own_address
        for text in ("one", "two"):
            placed = await place_mark(address, text)
            assert (placed.sessions, placed.file) == ((), str(tmp_path / "sessions" / RIG_MARKS))
        earlier_ns = time.perf_counter_ns() - 60 * 10**9
        mark = (await place_mark(address, "a minute ago", earlier_ns)).mark
        assert abs(mark.leader_ns - host_from_monotonic(earlier_ns)) <= mark.uncertainty_ns
        for text in ("", "two\nlines", "x" * 201, "\x1b[2J"):
            with pytest.raises(BadInputError, match="a mark cannot have"):
                await place_mark(address, text)
    lines = (tmp_path / "sessions" / RIG_MARKS).read_bytes().splitlines()
    assert [mark.text for mark in marks_of(lines)] == ["one", "two", "a minute ago"]


async def test_a_mark_is_at_its_call_however_long_the_connection_takes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    connected_ns = 0

    async def connect(*arguments: Any) -> Any:
        nonlocal connected_ns
        await asyncio.sleep(0.05)
        connected = await channel.connect(*arguments)
        connected_ns = time.perf_counter_ns()
        return connected

    async with rig_of(0, tmp_path) as leader:
        monkeypatch.setattr("capture_app.rig.rig_time.connect", connect)
        mark = (await place_mark(leader.own_address, "now")).mark
    assert mark.leader_ns - mark.uncertainty_ns < host_from_monotonic(connected_ns) - 40_000_000


@pytest.mark.parametrize("role", [None, Role.CAMERA])
async def test_only_an_operator_marks_and_reads_the_time(tmp_path: Path, role: Role | None) -> None:
    trust = Trust(tmp_path / "trust")
    with trust.in_use():
        async with await start_leader(tmp_path / "sessions", trust=trust) as leader:
            await place_mark(leader.own_address, "ours")
            other = Trust(tmp_path / "other") if role is None else introduced(tmp_path, trust, "other", role)
            if role is None:
                # It knows the leader, and the leader does not know it.
                one = trust.identity
                other.known.add(one.pin, Role.LEADER, name="leader", certificate=one.certificate)
            with other.in_use():
                with pytest.raises(UnknownMachineError):
                    await place_mark(leader.own_address, "theirs")
                with pytest.raises(UnknownMachineError):
                    await rig_time(leader.own_address)
    assert b"theirs" not in (tmp_path / "sessions" / RIG_MARKS).read_bytes()


def test_lines_that_are_no_mark_are_passed_over(tmp_path: Path) -> None:
    mark = Mark(text="a", leader_ns=5, uncertainty_ns=1)
    session = record(SessionWriter.create(tmp_path, "take-001"))
    with (session.folder / "events.ndjson").open("ab") as events:
        events.write(b'{"event":"joined"}\nnonsense\n{"event":"mark","text":3}\n\xff\n')
        events.write(b'{"event":"mark","text":"a","leader_ns":5,"uncertainty_ns":1,"later":true}\n')
    assert open_session(session.folder).marks == (mark,)
    (session.folder / "events.ndjson").unlink()
    assert open_session(session.folder).marks == ()
