"""The settings of the next take: their limits, what is remembered, and the plan that they become."""

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.rig.taking import TakePlan
from capture_app.tui.screen_settings import Settings
from capture_app.tui.shoot.shoot_plan import MAX_BEFORE, MAX_FRAMES, ROWS, TakeMode, TakeSettings, stepped


@given(st.integers(-5, 500), st.integers(-5, 500), st.integers(-9, 9), st.integers(-9, 9))
def test_a_plan_stays_within_what_a_leader_takes(frames: int, before: int, more: int, further: int) -> None:
    settings = TakeSettings(frames=frames, before=before)
    settings = settings.with_before(settings.before + more).with_after(settings.after + further)
    plan = settings.plan()
    assert 1 <= plan.frames <= MAX_FRAMES
    assert 0 <= plan.before <= min(MAX_BEFORE, plan.frames)
    assert settings.after == plan.frames - plan.before


def test_before_and_after_are_changed_alone() -> None:
    plan = TakeSettings(frames=8, before=3)
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
    TakeSettings(**kept, name="dancer", note="x").remember(settings)
    assert TakeSettings.recall(settings) == TakeSettings(**kept, name="dancer")
    settings.choices |= {"shoot.mode": "crazy", "shoot.name": "../x", "shoot.frames": -3}
    recalled = TakeSettings.recall(settings)
    assert (recalled.plan().frames, recalled.name, recalled.mode) == (1, "", "single")


def test_steps_begin_at_the_nearest_value() -> None:
    assert stepped((0, 3, 5, 10), 4.4, 1) == 10
    assert stepped((0, 3, 5, 10), 10, 1) == 10
    assert stepped((0, 3, 5, 10), 3, -1) == 0


@pytest.mark.parametrize(
    ("mode", "plan"),
    [
        ("single", TakePlan(frames=8, before=3, countdown_s=5)),
        ("interval", TakePlan(frames=8, before=3, countdown_s=5, repeat=3, every_s=10)),
        ("sequence", TakePlan(frames=8, before=3, countdown_s=5, repeat=3)),
        (
            "motion",
            TakePlan(frames=8, before=3, countdown_s=5, repeat=3, every_s=10, on_motion=(0.0, 0.0, 0.5, 1.0)),
        ),
        ("recording", TakePlan(video=True, seconds=60, countdown_s=5)),
    ],
)
def test_settings_become_a_plan(mode: TakeMode, plan: TakePlan) -> None:
    settings = TakeSettings(mode=mode, countdown_s=5, every_s=10, region="left half", seconds=60)
    assert settings.plan() == plan


def test_a_recording_saves_each_nth_frame_for_as_much_longer() -> None:
    settings = TakeSettings(mode="recording", nth=10)
    assert settings.plan(20.0, 40_000_000) == TakePlan(video=True, seconds=200.0, interval_s=0.4)
    assert settings.plan().interval_s is None, "no rig yet"
    assert replace(settings, nth=0).plan(None, 40_000_000) == TakePlan(video=True), (
        "of a file that was edited"
    )
    assert replace(settings, mode="single").plan(20.0, 40_000_000).interval_s is None
    (rate,) = (row for row in ROWS if row.label == "rate")
    assert rate.text(settings, 40_000_000) == "2.5 fps"
    assert rate.change is not None
    assert rate.change(settings, 1).nth == 5, "more frames a second"
