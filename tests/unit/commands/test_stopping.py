"""A command that is asked to end: once to end in order, and again to end at once."""

import asyncio
import os
from collections.abc import Callable

import pytest

from capture_app.commands import shared_options
from capture_app.commands.shared_options import SAME_SIGNAL_S, run_until_stopped
from capture_app.common import system
from tests.virtual.in_process import virtual_loop


@pytest.mark.parametrize(
    ("signals_s", "ends_s"),
    [
        ([0.0], 60.0),
        ([0.0, 0.1, 1.0], 60.0),
        ([0.0, SAME_SIGNAL_S + 1], SAME_SIGNAL_S + 1),
        ([0.0, -0.5], 0.5),
    ],
    ids=["once", "by several at once", "twice", "Ctrl-C again"],
)
def test_only_a_second_request_cuts_off_what_is_saved_at_the_end(
    monkeypatch: pytest.MonkeyPatch, signals_s: list[float], ends_s: float
) -> None:
    ended_s: list[float] = []

    def on_end(end: Callable[[], object]) -> None:
        for at_s in signals_s:
            loop.call_later(abs(at_s), end if at_s >= 0 else interrupt)

    def interrupt() -> None:
        raise KeyboardInterrupt

    def leave(code: int) -> None:
        ended_s.append(loop.time() - begun_s)
        raise SystemExit(code)

    async def save() -> None:
        try:
            await asyncio.sleep(600)
        finally:
            await asyncio.sleep(60)
            ended_s.append(loop.time() - begun_s)

    async def work() -> None:
        async with asyncio.TaskGroup() as nodes:
            nodes.create_task(save())

    loop = virtual_loop()
    begun_s = loop.time()
    monkeypatch.setattr(shared_options, "wait_for_no_reader", lambda: None)
    monkeypatch.setattr(shared_options, "restrict_file_access", lambda: None)
    monkeypatch.setattr(os, "_exit", leave)
    monkeypatch.setattr(system, "new_event_loop", lambda: loop)
    monkeypatch.setattr(system, "on_end", on_end)
    with pytest.raises((KeyboardInterrupt, SystemExit)):
        run_until_stopped(work())
    assert ended_s[0] == pytest.approx(ends_s, abs=0.1)
