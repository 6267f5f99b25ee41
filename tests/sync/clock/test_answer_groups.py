"""Groups of answers, over pauses of every length."""

import pytest

from capture_app.sync.clock.answer_groups import GROUP, AnswerGroups

S = 10**9
WINDOW_NS = 60 * S


@pytest.mark.parametrize("before", range(1, 3 * GROUP))
@pytest.mark.parametrize("pause_s", [59, 61, 3600])
def test_a_pause_longer_than_the_window_begins_anew(before: int, pause_s: int) -> None:
    groups = AnswerGroups(WINDOW_NS)
    times_s = [*range(before), *range(before + pause_s, before + pause_s + 3 * GROUP)]
    whole = [groups.add((s * S, 500_000), (s * S + 1_000_000, 400_000), 0.0) for s in times_s]
    assert any(whole[-GROUP:])
    if pause_s > 60:
        assert not any(whole[before : before + GROUP - 1])  # no group is of answers from both sides
