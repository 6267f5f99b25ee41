"""Clips of two cameras are paired by what cannot be a coincidence, and what is assumed is said."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from capture_app.companions.importing.clips import Clip, pair_clips
from capture_app.session.importing.name_roles import take_names

HOUR_S = 3600.0


def clips(camera: str, starts_h: Sequence[float | None], stem: str = "{}", first: int = 1) -> list[Clip]:
    return [
        Clip(Path(camera) / f"{stem.format(first + n)}.mp4", 8.0, None if at is None else at * HOUR_S)
        for n, at in enumerate(starts_h)
    ]


def paired(
    one: list[Clip], other: list[Clip], heard: dict[int, int] | None = None
) -> tuple[list[tuple[int, int]], str]:
    """The pairs by their places; `heard`: the second clip with the sound of one of the first."""
    pairs, note = pair_clips(
        ("a", "b"),
        one,
        other,
        lambda x, y: (heard or {}).get([c.path for c in one].index(x)) == [c.path for c in other].index(y),
        take_names({"a": [clip.path for clip in one], "b": [clip.path for clip in other]}),
    )
    return [(one.index(x), other.index(y)) for x, y in pairs], note


ALL = [(0, 0), (1, 1), (2, 2)]


def test_one_difference_common_to_all_takes_is_found_and_said() -> None:
    one, other = clips("a", [10, 11, 12], "C{:04}"), clips("b", [11, 12, 13], "MVI_{:04}")
    pairs, note = paired(one, other)
    assert pairs == ALL
    assert note.startswith(
        "by their dates alone, the clock of b is 1:00:00 h ahead of that of a in all takes"
    )
    pairs, note = paired(one, other, {0: 0, 1: 1, 2: 2})
    assert (pairs, note[:14]) == (ALL, "by their sound")


def test_sound_tells_a_missed_take_from_a_wrong_clock() -> None:
    one, other = clips("a", [10, 11, 12], "C{:04}"), clips("b", [11, 12, 13], "MVI_{:04}")
    pairs, note = paired(one, other, {1: 0, 2: 1})
    assert pairs == [(1, 0), (2, 1)]
    assert note.startswith("by their sound, a and b have equal clocks")


@pytest.mark.parametrize("behind_h", [-2.0, 0.37, 51.25])
def test_any_constant_is_found(behind_h: float) -> None:
    starts = [10.0, 10.3, 11.9]
    pairs, note = paired(clips("a", starts), clips("b", [at - behind_h for at in starts], "x{}"))
    assert pairs == ALL
    assert "h ahead of that of" in note


def test_equal_clocks_need_no_word() -> None:
    assert paired(clips("a", [10, 11, 12]), clips("b", [10, 11, 12], "x{}")) == (ALL, "")
    assert paired(clips("a", [10, 11, 12]), clips("b", [11, 12], "x{}")) == ([(1, 0), (2, 1)], "")


def test_counters_mean_nothing_and_names_of_takes_do() -> None:
    counted = clips("a", [10, 11, 12], "IMG_{:04}"), clips("b", [11, 12], "IMG_{:04}")
    assert paired(*counted)[0] == [(1, 0), (2, 1)]
    named = clips("a", [10, 11, 12], "walk{}"), clips("b", [11, 12], "walk{}")
    assert paired(*named) == ([(0, 0), (1, 1)], "")


def test_without_dates_the_order_counts_only_if_none_is_missing() -> None:
    nothing: list[float | None] = [None, None, None]
    pairs, note = paired(clips("a", nothing), clips("b", nothing, "x{}"))
    assert (pairs, note) == (ALL, "the clips of a and b are paired by their order")
    assert paired(clips("a", nothing), clips("b", nothing[:2], "x{}")) == ([], "")


def test_dates_that_fit_no_difference_pair_what_they_pair() -> None:
    pairs, note = paired(clips("a", [10, 11, 12]), clips("b", [10, 15.5, 17.25], "x{}"))
    assert (pairs, note) == ([(0, 0)], "")
