"""Room for a burst: known sizes before claimed ones, an equal share for each machine."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from capture_app.common.errors import DiskFullError
from capture_app.common.node_state import NodeState
from capture_app.node.leader import readiness
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.readiness import check_room
from capture_app.protocol.messages import SpoolSpace
from capture_app.session.files.disk import SPARE_BYTES
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.roster import Member
from capture_app.sync.wire.datagrams import Report
from tests.facts import make_facts
from tests.unit.node.test_limits import join_many

pytestmark = pytest.mark.virtual

MB = 1_000_000
FREE = 1_000 * MB + SPARE_BYTES


@pytest.fixture(autouse=True)
def disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk with little room."""
    monkeypatch.setattr(readiness, "free_bytes", lambda _: FREE)


def camera(name: str, machine: str = "", *, host: str = "10.0.0.2", width: int = 1000) -> Member:
    facts = make_facts(kind="v4l2", width=width, height=4000)
    return Member(name, 1, 1, (host, 5), facts, Report(state=NodeState.READY), 0, 0.0, pin=machine)


def left_out(
    *cameras: Member,
    frames: int = 100,
    known: Mapping[str, int] | None = None,
    spools: Mapping[str, SpoolSpace] | None = None,
) -> dict[str, str]:
    return check_room(Path("/rig"), cameras, known or {}, frames, spools or {})


def test_a_machine_that_claims_huge_images_is_left_out_and_named() -> None:
    """It refused each recording: "may need 22,186 MB, make room"."""
    liar = camera("huge", "liar", width=1 << 20)
    without = left_out(camera("a", "one"), liar, camera("b", "two"))
    assert without == {
        "huge": "its machine may need 7,382.0 MB, and its share of the leader's disk is 780.0 MB"
    }
    assert left_out(camera("a", "one"), liar).keys() == {"huge"}, "beside one other, too"


@pytest.mark.parametrize("is_open", [False, True], ids=["by its pin", "by its address in an open rig"])
def test_many_names_of_one_machine_have_one_share(is_open: bool) -> None:
    many = [camera(f"n{n}", "" if is_open else "many", host="10.0.0.66") for n in range(60)]
    others = [camera(name, "" if is_open else name, host=f"10.0.0.{n}") for n, name in enumerate("ab")]
    assert left_out(*many, *others).keys() == {one.name for one in many}
    assert left_out(*many[:5], *others) == {}, "what fits is never refused"


def test_what_is_known_from_images_counts_before_what_is_claimed() -> None:
    known = {"a": 4 * MB, "b": 4 * MB}
    honest = [camera("a", "one"), camera("b", "one")]
    assert left_out(*honest, camera("new", "two", width=4000), known=known).keys() == {"new"}
    assert left_out(*honest, camera("new", "two", width=1), known=known) == {}


def test_a_disk_that_is_too_small_for_most_machines_refuses_the_burst() -> None:
    """A take of few cameras is no help: who sees the error makes room, or takes fewer frames."""
    equal = [camera(f"cam{n}", f"machine{n}") for n in range(5)]
    for cameras in (equal, equal[:1], [camera(f"cam{n}", "one") for n in range(5)]):
        with pytest.raises(DiskFullError, match=r"the burst may need .* and /rig has 1,002.1 MB free"):
            left_out(*cameras, frames=1000)
        with pytest.raises(DiskFullError, match="the burst may need"):
            left_out(*cameras, frames=200, known={one.name: 10**10 for one in cameras})


def test_a_camera_whose_spool_is_too_small_is_left_out() -> None:
    known, spool = {"a": 100, "b": 100}, SpoolSpace(camera="a", free_bytes=1_000, spool="/spool")
    cameras = camera("a", "one"), camera("b", "two")
    assert left_out(*cameras, frames=9, known=known, spools={"a": spool}) == {}
    without = left_out(*cameras, frames=10, known=known, spools={"a": spool})
    assert without == {"a": "it may need 0.0 MB, and has 0.0 MB free in its /spool"}


async def test_a_recording_goes_on_without_the_machine_over_its_share(leader: LeaderNode) -> None:
    join_many(leader, "honest-one", ["cam0"])
    join_many(leader, "honest-two", ["cam1"])
    join_many(leader, "liar", ["huge"])
    for name, member in leader.engine.roster.members.items():
        width = 1 << 20 if name == "huge" else 640
        member.camera = make_facts(kind="v4l2", width=width)
    session = await leader.bursts.order(BurstOrder(frames=10_000, streamed=True, video=True))
    assert session.burst.clients == ("cam0", "cam1")
    assert session.status.message.startswith("without huge: its machine may need")
