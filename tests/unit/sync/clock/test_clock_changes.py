"""States of a clock that changed: it may change again, and has its former rate again after a fast slew."""

import pytest

from capture_app.sync.clock.clock_changes import (
    AGAIN_NS,
    BACK_SKEW,
    FAST_SKEW,
    SHOWN_NS,
    SLEWED_NS,
    ClockChanges,
    ClockState,
)

S = 10**9
BEFORE, SLEWED, ERROR = 20e-6, 520e-6, 10e-6


def changed(*, is_fast: bool) -> ClockChanges:
    """A clock that has changed at 40 s; one that is slewed beyond measure, twice."""
    changes = ClockChanges()
    assert changes.state is ClockState.STEADY
    if is_fast:
        changes.note(40 * S - AGAIN_NS + 1, BEFORE)
    changes.note(40 * S, BEFORE)
    assert changes.state is ClockState.CHANGED
    return changes


def test_a_clock_that_was_slewed_fast_is_back_at_its_former_rate() -> None:
    changes = changed(is_fast=True)
    changes.judge(42 * S, SLEWED, ERROR, is_known=True)
    assert changes.state is ClockState.CHANGED
    changes.judge(43 * S, BEFORE, BACK_SKEW, is_known=True)
    assert changes.state is ClockState.CHANGED, "its rate is not known well enough"
    changes.judge(43 * S, BEFORE + ERROR, ERROR, is_known=False)
    assert changes.state is ClockState.CHANGED, "few samples look surer than they are"
    changes.judge(44 * S, BEFORE + ERROR, ERROR, is_known=True)
    assert changes.state is ClockState.RESTORED
    changes.judge(40 * S + SLEWED_NS, BEFORE, ERROR, is_known=True)
    assert changes.state is ClockState.STEADY


def test_a_slow_change_may_go_on_unseen_although_the_rate_looks_as_before() -> None:
    changes = changed(is_fast=False)
    changes.judge(44 * S, BEFORE, ERROR, is_known=True)
    assert changes.state is ClockState.CHANGED
    changes.judge(45 * S, BEFORE + FAST_SKEW, ERROR, is_known=True)
    changes.judge(46 * S, BEFORE, ERROR, is_known=True)
    assert changes.state is ClockState.CHANGED, "not far beyond the error"


def test_the_rate_itself_shows_a_fast_slew_once_it_is_known() -> None:
    changes = changed(is_fast=False)
    changes.judge(42 * S, SLEWED, ERROR, is_known=False)
    changes.judge(43 * S, BEFORE, ERROR, is_known=True)
    assert changes.state is ClockState.CHANGED, "noise of a slow slew looks like it for a moment"
    changes.judge(44 * S, SLEWED, ERROR, is_known=True)
    changes.judge(56 * S, BEFORE, ERROR, is_known=True)
    assert changes.state is ClockState.RESTORED


def test_a_clock_that_stepped_is_back_once_its_rate_is_known() -> None:
    changes = ClockChanges()
    changes.note(40 * S, BEFORE, is_step=True)
    changes.judge(41 * S, BEFORE, ERROR, is_known=False)
    assert changes.state is ClockState.CHANGED
    changes.judge(42 * S, BEFORE, ERROR, is_known=True)
    assert changes.state is ClockState.RESTORED


def test_the_former_rate_is_that_before_the_first_of_several_changes() -> None:
    changes = changed(is_fast=True)
    changes.note(50 * S, SLEWED)
    changes.judge(54 * S, BEFORE, ERROR, is_known=True)
    assert changes.state is ClockState.RESTORED


@pytest.mark.parametrize(("at_s", "is_reported"), [(45, True), (40 + SHOWN_NS / S + 1, False)])
def test_a_rate_change_is_reported_if_it_shows_soon(at_s: float, is_reported: bool) -> None:
    changes = changed(is_fast=False)
    changes.judge(round(at_s * S), SLEWED, ERROR, is_known=True)
    assert (changes.rate_changed_ns == 40 * S) is is_reported
