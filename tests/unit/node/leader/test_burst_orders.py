"""Requests for takes as orders in a rig's frames; what takes are told of on the way, and where marks go."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from capture_app.common.errors import BadInputError
from capture_app.node.leader import bursts as leader_bursts
from capture_app.node.leader.bursts import ActiveBursts, create_numbered, order_of
from capture_app.protocol.messages import BurstRequest, SpoolSpace
from capture_app.session.format.manifest import EVENTS
from capture_app.session.format.marks import RIG_MARKS, Mark
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.frame_selection import MAX_STREAMED_FRAMES, MAX_STREAMED_NS
from tests.unit.node.leader.test_active_bursts import NOW_NS, bursts_of, engine_of, order

pytestmark = pytest.mark.virtual

S = 10**9
PERIOD_NS = 20_000_000
"""50 frames a second."""


@pytest.mark.parametrize(
    ("request_", "ordered"),
    [
        (BurstRequest(frames=3), BurstOrder(frames=3, spare=4)),
        (BurstRequest(frames=9), BurstOrder(frames=9, spare=9)),
        (BurstRequest(frames=9, spare=0), BurstOrder(frames=9, spare=0)),
        (BurstRequest(frames=1, spacing=7), BurstOrder(frames=1, spacing=7, spare=4)),
        (BurstRequest(frames=1, interval_s=0.1), BurstOrder(frames=1, spacing=5, spare=4)),
        (BurstRequest(frames=1, interval_s=0.102), BurstOrder(frames=1, spacing=5, spare=4)),
        (BurstRequest(frames=1, interval_s=0.0197), BurstOrder(frames=1, spacing=1, spare=4)),
        (BurstRequest(seconds=0.5), BurstOrder(frames=25, spare=25)),
        (BurstRequest(seconds=0.5, interval_s=0.1), BurstOrder(frames=5, spacing=5, spare=5)),
        (BurstRequest(frames=3, seconds=0.5), BurstOrder(frames=3, spare=4)),
        (BurstRequest(seconds=0.001), BurstOrder(frames=1, spare=4)),
        (BurstRequest(frames=3, before=2), BurstOrder(frames=3, spare=4, at_leader_ns=60 * S - 40_000_000)),
        (
            BurstRequest(frames=3, before=1, spacing=2, at_leader_ns=70 * S),
            BurstOrder(frames=3, spacing=2, spare=4, at_leader_ns=70 * S - 40_000_000),
        ),
        (BurstRequest(frames=3, at_leader_ns=70 * S), BurstOrder(frames=3, spare=4, at_leader_ns=70 * S)),
        # What lasts longer than two seconds is sent as it is captured, unless spare instants are asked for.
        (BurstRequest(frames=101), BurstOrder(frames=101, spare=101)),
        (BurstRequest(frames=102), BurstOrder(frames=102, spare=102, streamed=True)),
        (BurstRequest(frames=102, spare=5), BurstOrder(frames=102, spare=5)),
        (BurstRequest(frames=21, interval_s=0.1), BurstOrder(frames=21, spacing=5, spare=21)),
        (BurstRequest(frames=22, interval_s=0.1), BurstOrder(frames=22, spacing=5, spare=22, streamed=True)),
        (
            BurstRequest(frames=2, spare=0, video=True),
            BurstOrder(frames=2, spare=0, streamed=True, video=True),
        ),
    ],
    ids=repr,
)
def test_a_request_is_ordered_in_frames_of_the_rig(request_: BurstRequest, ordered: BurstOrder) -> None:
    assert order_of(request_, 60 * S, PERIOD_NS) == ordered


def test_a_recording_without_an_end_is_as_long_as_any_may_be() -> None:
    order = order_of(BurstRequest(video=True), 0, PERIOD_NS)
    assert order.frames == min(MAX_STREAMED_FRAMES, MAX_STREAMED_NS // PERIOD_NS)
    slow = order_of(BurstRequest(video=True), 0, MAX_STREAMED_NS // 10)
    assert slow.frames == 10


@pytest.mark.parametrize("interval_s", [0.0195, 0.01, 0.03, 0.1025])
def test_an_interval_that_is_no_number_of_frames_is_refused_with_those_that_are(interval_s: float) -> None:
    with pytest.raises(
        BadInputError, match=r"^(51.28|100|33.33|9.756) frames a second do not divide the rig's 50 evenly"
    ) as refused:
        order_of(BurstRequest(frames=2, interval_s=interval_s), 0, PERIOD_NS)
    assert refused.value.hint == "use one of: 50, 25, 16.67, 12.5, 10 ..."


def test_a_session_gets_the_number_after_the_highest_of_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    others = ("burst-007", "burst-1000000", "burst-x99", "burst-", "jump-012", "a-burst-020")
    for name in others:
        (tmp_path / name).mkdir()

    def created(**options: Any) -> tuple[str, int]:
        writer, number = create_numbered(tmp_path, **options)
        writer.abort()
        return writer.name, number

    assert created() == ("burst-008", 8)
    assert created(prefix="jump", after=11) == ("jump-013", 13)
    assert created(after=20) == ("burst-021", 21)
    assert created(after=999_998) == ("burst-999999", 999_999)
    with monkeypatch.context() as patch:
        # Another program makes folders meanwhile.
        patch.setattr(Path, "glob", lambda *_, **__: iter(()))
        assert created(after=6) == ("burst-009", 9)
    (tmp_path / "a file").write_bytes(b"")
    with pytest.raises(BadInputError):
        create_numbered(tmp_path / "a file")


async def test_a_mark_is_stored_in_the_takes_it_falls_into_or_with_the_rig(tmp_path: Path) -> None:
    async with bursts_of(tmp_path, engine_of("a")) as bursts:
        session = await order(bursts)
        within = Mark(text="clap", leader_ns=session.burst.instants_ns[0], uncertainty_ns=5)
        placed = await bursts.place_mark(within)
        assert (placed.sessions, placed.file) == ((session.folder.name,), "")
        outside = Mark(text="door", leader_ns=session.burst.instants_ns[-1] + 60 * S, uncertainty_ns=5)
        placed = await bursts.place_mark(outside)
        assert (placed.sessions, placed.file) == ((), str(tmp_path / RIG_MARKS))
        text = "\n".join(file.read_text() for file in session.folder.glob("*.ndjson"))
        assert ("clap" in text, "door" in text) == (True, False)
        assert "door" in (tmp_path / RIG_MARKS).read_text()
        second = await order(bursts)
        placed = await bursts.place_mark(replace(within, text="both"))
        assert placed.sessions == (session.folder.name, second.folder.name)
        assert all("both" in (take.folder / EVENTS).read_text() for take in (session, second))
        with pytest.raises(BadInputError):
            await bursts.place_mark(Mark(text="two\nlines", leader_ns=NOW_NS, uncertainty_ns=5))


async def test_frames_before_an_order_are_those_before_its_rig_was_ready(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with bursts_of(tmp_path, engine_of("a")) as bursts:
        clock: Any = bursts._options.clock

        async def reasons(*_: object) -> AsyncIterator[str]:
            yield "a is aligning"
            clock.shown_ns += 60 * S

        monkeypatch.setattr(leader_bursts, "reasons_until_ready", reasons)
        taking = bursts.take(BurstRequest(frames=2, before=1, wait_ready_s=90))
        assert [(await anext(taking)).burst for _ in range(2)] == [0, 1]
        assert bursts.newest is not None
        assert abs(bursts.newest.burst.instants_ns[1] - clock.shown_ns) < S
        await taking.aclose()


async def test_a_problem_of_a_spool_is_logged_when_it_begins_and_ends(tmp_path: Path) -> None:
    async with bursts_of(tmp_path, engine_of("a")) as bursts:
        for problem in ("", "is full", "is full", "", ""):
            space = SpoolSpace(camera="a", free_bytes=len(problem), spool="/", problem=problem)
            bursts.note_spool_space(space)
            assert bursts.spools == {"a": space}
        assert lines(bursts) == ["a: is full", "a: its disk is usable again"]


def lines(bursts: ActiveBursts) -> list[str]:
    return [line.text for line in bursts._options.log.after(0)]
