"""The log of a rig: what it keeps, what it shows, and what is left out where one node says too much."""

from typing import Any

import pytest

from capture_app.common import system
from capture_app.protocol import log as module
from capture_app.protocol.log import MAX_LETTERS, RATE_WINDOW_S, Log
from capture_app.protocol.status import BurstStatus
from capture_app.sync.rig.events import NodeChanged, TriggerAnswered


class Times:
    """A host's clocks."""

    now_s, unix_ns = 1000.0, 5_000


@pytest.fixture
def times(monkeypatch: pytest.MonkeyPatch) -> Times:
    times = Times()
    monkeypatch.setattr(system, "monotonic_s", lambda: times.now_s)
    monkeypatch.setattr("time.time_ns", lambda: times.unix_ns)
    return times


def said(log: Log, after_ns: int = 0) -> list[tuple[str, str | None, str]]:
    return [(line.text, line.camera, line.level) for line in log.after(after_ns)]


def test_lines_are_about_a_node_and_their_times_increase_though_the_clock_is_set_back(times: Times) -> None:
    shown: list[str] = []
    log = Log(shown.append, name="own")
    log.say("one")
    times.unix_ns = 3_000
    log.say("two", camera="a", level="error")
    times.unix_ns = 9_000
    log.add("three", camera=None, level="warning")
    assert said(log) == [("one", "own", "info"), ("two", "a", "error"), ("three", None, "warning")]
    assert [line.unix_ns for line in log.after(0)] == [5_000, 5_001, 9_000]
    assert said(log, 5_001) == [("three", None, "warning")]
    assert shown == ["one", "two"]


@pytest.mark.usefixtures("times")
def test_a_line_that_repeats_the_last_one_is_kept_once_and_only_so_many_letters_of_it() -> None:
    log = Log()
    for text, camera in (("full", "a"), ("full", "a"), ("full", "b"), ("full", "a"), ("x" * 2000, "a")):
        log.add(text, camera=camera)
    assert [(text, camera) for text, camera, _ in said(log)][:3] == [
        ("full", "a"),
        ("full", "b"),
        ("full", "a"),
    ]
    assert len(said(log)[-1][0]) == MAX_LETTERS
    log.say("y" * 2000)
    assert len(said(log)[-1][0]) == MAX_LETTERS


def test_one_node_and_all_together_fill_no_log_and_are_heard_again_later(
    monkeypatch: pytest.MonkeyPatch, times: Times
) -> None:
    monkeypatch.setattr(module, "MAX_LINES_A_NODE", 3)
    monkeypatch.setattr(module, "MAX_LINES_OF_NODES", 5)
    log = Log()
    log.title_of = str.upper
    for number in range(9):
        log.say(f"{number}", camera="a")
        log.say(f"{number}", camera="b" if number < 2 else "c")
        log.say(f"own {number}")
    assert [text for text, camera, _ in said(log) if camera == "a"] == [
        "0", "1", "A: its further lines are left out for up to 10 s",
    ]  # fmt: skip
    assert [text for text, camera, _ in said(log) if camera in ("b", "c")] == ["0", "1"]
    assert len([text for text, camera, _ in said(log) if camera is None]) == 9, "its own lines all count"
    times.now_s += RATE_WINDOW_S - 1e-6
    log.say("early", camera="a")
    assert said(log)[-1][0] == "own 8"
    times.now_s += 1e-6
    log.say("again", camera="a")
    assert said(log)[-1][0] == "again"


def test_a_disk_is_said_to_be_unusable_and_usable_again_and_whose() -> None:
    log = Log()
    log.title_of = str.upper
    for name, problem in (("a", "is full"), ("a", ""), (None, "is gone")):
        log.say_of_disk(name, problem)
    assert said(log) == [
        ("A: is full", "a", "warning"), ("A: its disk is usable again", "a", "info"),
        ("leader: is gone", None, "warning"),
    ]  # fmt: skip


def test_events_are_shown_and_recorded_and_a_bursts_progress_is_in_no_log() -> None:
    shown, recorded = list[str](), list[dict[str, Any]]()
    log = Log(shown.append, record=recorded.append)
    log.title_of = str.upper
    running = BurstStatus(
        burst=1, name="walk", cameras=1, instants=2, received=1, expected=2, done=False, session=None
    )
    log.note(NodeChanged("a", "lost", "it left"))
    log.note(running)
    log.note(TriggerAnswered("a", 1))
    log.note(
        BurstStatus(**{name: getattr(running, name) for name in running.__struct_fields__} | {"done": True})
    )
    assert said(log) == [
        ("lost A: it left", "a", "warning"), ("burst 1: 1 of 2 images, no session", None, "warning"),
    ]  # fmt: skip
    assert shown == [
        "lost A: it left", "burst 1: 1 of 2 images", "burst 1: 1 of 2 images, no session",
    ]  # fmt: skip
    assert [record["event"] for record in recorded] == [
        "node-lost", "burst-status", "burst-accepted", "burst-status",
    ]  # fmt: skip


def test_an_event_of_a_node_that_says_too_much_is_neither_shown_nor_recorded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "MAX_LINES_A_NODE", 1)
    shown, recorded = list[str](), list[dict[str, Any]]()
    log = Log(shown.append, record=recorded.append)
    for reason in ("first", "second"):
        log.note(NodeChanged("a", "lost", reason))
    assert (len(shown), len(recorded), len(said(log))) == (1, 1, 1)
