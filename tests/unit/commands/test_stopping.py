"""A command that is asked to end: once to end in order, and again to end at once."""

import asyncio
from collections.abc import Callable

import pytest

from capture_app.commands import shared_options
from capture_app.commands.shared_options import SAME_SIGNAL_S, run_until_stopped
from tests.virtual.in_process import virtual_loop


@pytest.mark.parametrize(
    ("signals_s", "ends_s"),
    [([0.0], 60.0), ([0.0, 0.1, 1.0], 60.0), ([0.0, SAME_SIGNAL_S + 1], SAME_SIGNAL_S + 1)],
    ids=["once", "by several at the same moment", "twice"],
)
def test_only_a_second_request_cuts_off_what_is_saved_at_the_end(
    monkeypatch: pytest.MonkeyPatch, signals_s: list[float], ends_s: float
) -> None:
    ended_s: list[float] = []

    def on_end(end: Callable[[], object]) -> None:
        for at_s in signals_s:
            asyncio.get_running_loop().call_later(at_s, end)

    async def save() -> None:
        now_s = asyncio.get_running_loop().time
        begun_s = now_s()
        try:
            await asyncio.sleep(600)
        finally:
            try:
                await asyncio.sleep(60)
            finally:
                ended_s.append(now_s() - begun_s)

    async def work() -> None:
        async with asyncio.TaskGroup() as nodes:
            nodes.create_task(save())

    monkeypatch.setattr(shared_options, "wait_for_no_reader", lambda: None)
    monkeypatch.setattr(shared_options, "restrict_file_access", lambda: None)
    monkeypatch.setattr(shared_options.system, "new_event_loop", virtual_loop)
    monkeypatch.setattr(shared_options.system, "on_end", on_end)
    with pytest.raises(KeyboardInterrupt):
        run_until_stopped(work())
    assert ended_s == [pytest.approx(ends_s, abs=0.1)]
