"""What messages say of themselves, errors that pass from a leader to its peers, and a status page by page."""

import asyncio
from typing import Any

import msgspec
import pytest

from capture_app.common import errors
from capture_app.common.errors import NetworkError, SimulshotError
from capture_app.common.node_state import NodeState
from capture_app.net.asking import ask_all_nodes
from capture_app.protocol import messages
from capture_app.protocol.messages import ImageBatch, ImageUpload, Refusal
from capture_app.protocol.status import NodeStatus, RigStatus
from capture_app.session.format.manifest import ImageRecord, image_path
from tests.facts import make_facts

KINDS = [
    kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, SimulshotError)
]


def upload(instant: int, truth_bytes: int = 0) -> ImageUpload:
    record = ImageRecord(
        camera="a", instant=instant, path=image_path("a", instant), leader_ns=0, bytes=10 + instant,
        sha256=f"{instant}" * 64,
    )  # fmt: skip
    return ImageUpload(leader=7, burst=2, record=record, truth_bytes=truth_bytes)


def test_a_batch_is_of_the_burst_of_its_images_and_acknowledged_by_its_last() -> None:
    batch = ImageBatch(images=(upload(1), upload(2, truth_bytes=100), upload(3)))
    assert (batch.leader, batch.burst, batch.camera) == (7, 2, "a")
    assert (batch.bytes, batch.sha256) == (11 + 112 + 13, "3" * 64)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_an_error_of_a_leader_is_the_same_at_its_peer_and_says_whether_to_ask_again(kind: Any) -> None:
    error = kind("no room", hint="make room")
    if kind is errors.DamagedImageError:
        error.instants = (3, 5)
    refusal = msgspec.json.decode(msgspec.json.encode(Refusal.of_error(error)), type=Refusal)
    again = refusal.as_error()
    assert (type(again), again.what, again.hint) == (kind, "no room", "make room")
    assert refusal.retry is issubclass(kind, errors.DiskError | errors.TryAgainError | errors.NetworkError)
    assert refusal.forget is issubclass(kind, errors.UnwantedImageError)
    assert refusal.damaged == ((3, 5) if kind is errors.DamagedImageError else ())


@pytest.mark.parametrize("name", ["", "NewerError", "Any", "ExitCode", "ungrouped_errors"])
def test_an_error_that_this_version_does_not_have_is_one_all_the_same(name: str) -> None:
    error = Refusal(what="no room", hint="make room", error=name).as_error()
    assert (type(error), error.what, error.hint) == (SimulshotError, "no room", "make room")


class Leader:
    """A leader's stream that answers requests for its status with pages."""

    peer = "10.0.0.1:47010"

    def __init__(self, *answers: Any) -> None:
        self.answers, self.asked = [*answers], list[str]()

    async def send(self, request: messages.StatusRequest) -> None:
        self.asked.append(request.after)

    async def receive_header(self) -> Any:
        if (answer := self.answers.pop(0)) is None:
            await asyncio.Event().wait()
        return answer


def page(*names: str, further: int = 0) -> messages.StatusAnswer:
    nodes = tuple(
        NodeStatus(name=name, address="x", camera=make_facts(), state=NodeState.READY) for name in names
    )
    return messages.StatusAnswer(
        rig=RigStatus(leader="x", now_ns=0, period_ns=1, nodes=nodes, further=further)
    )


@pytest.mark.parametrize(
    ("pages", "names", "asked"),
    [
        ([page("a", "b", further=1), page("c")], ["a", "b", "c"], ["", "b"]),
        ([page()], [], [""]),
        ([page("a", further=2), page(further=2)], ["a"], ["", "a"]),
    ],
)
async def test_all_nodes_of_a_large_rig_are_asked_for_page_by_page(
    pages: list[Any], names: list[str], asked: list[str]
) -> None:
    leader: Any = Leader(*pages)
    rig = await ask_all_nodes(leader)
    assert ([node.name for node in rig.nodes], leader.asked) == (names, asked)


@pytest.mark.virtual
@pytest.mark.parametrize(
    ("answer", "kind", "why"),
    [
        (None, NetworkError, "the leader at 10.0.0.1:47010 does not answer"),
        (Refusal(what="is full", error="DiskFullError"), errors.DiskFullError, "is full"),
        (messages.StatusRequest(), NetworkError, "sent a StatusRequest, not a StatusAnswer"),
    ],
)
async def test_a_leader_that_does_not_answer_as_asked_is_said(
    answer: Any, kind: type[SimulshotError], why: str
) -> None:
    leader: Any = Leader(answer)
    with pytest.raises(SimulshotError, match=why) as refused:
        await ask_all_nodes(leader)
    assert type(refused.value) is kind


@pytest.mark.parametrize(("is_open", "hint"), [(False, "check that it runs"), (True, "unset SIMULSHOT_OPEN")])
async def test_a_leader_that_closes_its_stream_may_require_pairing(
    monkeypatch: pytest.MonkeyPatch, is_open: bool, hint: str
) -> None:
    monkeypatch.setenv("SIMULSHOT_OPEN", str(int(is_open)))

    class Closed(Leader):
        async def receive_header(self) -> None:
            return None

    closed: Any = Closed()
    with pytest.raises(NetworkError, match="closed the connection") as refused:
        await ask_all_nodes(closed)
    assert refused.value.hint.endswith(hint)
