"""The plan of a take and its course, in virtual time."""

import asyncio
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.tui.settings import Settings
from capture_app.tui.shoot.plan import MOST_BEFORE, MOST_FRAMES, TakePlan, moments_of, stepped


class Course:
    """The course of a plan in virtual time; a take is saved `saving_s` after it is ordered."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        self.taken: list[float] = []
        self.moments: list[str] = []
        monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda: self.now)
        monkeypatch.setattr(asyncio, "sleep", self._sleep)

    async def run(self, plan: TakePlan, saving_s: float = 2.0) -> None:
        saved = asyncio.Event()
        async for moment in moments_of(plan, saved):
            self.moments.append(str(moment))
            if not moment.seconds:
                self.taken.append(self.now - 100.0)
                self.saving = asyncio.ensure_future(self._save(self.now + saving_s, saved))

    async def _save(self, due: float, saved: asyncio.Event) -> None:
        if due < self.now + 10:
            self.now = max(self.now, due)
            saved.set()

    async def _sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
async def course(monkeypatch: pytest.MonkeyPatch) -> Course:
    return Course(monkeypatch)


async def test_a_single_take_is_at_once(course: Course) -> None:
    await course.run(TakePlan())
    assert course.taken == [0.0]
    assert course.moments == ["the take is being taken"]


async def test_a_countdown_tells_each_second(course: Course) -> None:
    await course.run(TakePlan(countdown_s=3))
    assert course.taken == [3.0]
    counted = ["the take in 3 s", "the take in 2 s", "the take in 1 s", "the take is being taken"]
    assert course.moments == counted


async def test_an_interval_keeps_its_pace_whatever_saving_takes(course: Course) -> None:
    await course.run(TakePlan(mode="interval", every_s=5.0, takes=4, countdown_s=3), saving_s=60.0)
    assert course.taken == pytest.approx([3.0, 8.0, 13.0, 18.0])
    assert "take 2 of 4 in 5 s" in course.moments


async def test_a_sequence_waits_until_each_take_is_saved(course: Course) -> None:
    await course.run(TakePlan(mode="sequence", takes=3))
    assert course.taken == pytest.approx([0.0, 2.0, 4.0])


@given(st.integers(-5, 500), st.integers(-5, 500), st.integers(-9, 9), st.integers(-9, 9))
def test_a_plan_stays_within_what_a_leader_takes(frames: int, before: int, more: int, further: int) -> None:
    plan = TakePlan(frames=frames, before=before)
    plan = plan.with_before(plan.before + more).with_after(plan.after + further)
    request = plan.request()
    assert 1 <= request.frames <= MOST_FRAMES
    assert 0 <= request.before <= min(MOST_BEFORE, request.frames)
    assert plan.after == request.frames - request.before


def test_before_and_after_are_changed_alone() -> None:
    plan = TakePlan(frames=8, before=3)
    assert (plan.with_before(5).before, plan.with_before(5).after) == (5, 5)
    assert (plan.with_after(9).before, plan.with_after(9).after) == (3, 9)


def test_a_plan_is_remembered_but_for_its_notes() -> None:
    settings = Settings()
    kept: dict[str, Any] = {
        "frames": 20,
        "before": 7,
        "mode": "sequence",
        "countdown_s": 5.0,
        "every_s": 30.0,
        "takes": 10,
    }
    TakePlan(**kept, name="dancer", note="x").remember(settings)
    assert TakePlan.recall(settings) == TakePlan(**kept, name="dancer")
    settings.choices |= {"shoot.mode": "crazy", "shoot.name": "../x", "shoot.frames": -3}
    recalled = TakePlan.recall(settings)
    assert (recalled.request().frames, recalled.name, recalled.mode) == (1, "", "single")


def test_steps_begin_at_the_nearest_value() -> None:
    assert stepped((0, 3, 5, 10), 4.4, 1) == 10
    assert stepped((0, 3, 5, 10), 10, 1) == 10
    assert stepped((0, 3, 5, 10), 3, -1) == 0
