"""Whose clock runs at another rate than the others."""

import pytest

from capture_app.sync.timekeeping.rates import LEADER, HostOffRate, RateVote


def off(vote: RateVote) -> dict[str | None, float]:
    return {name: host.fast_ppm for name, host in vote.off.items()}


def test_ordinary_crystals_cause_no_event() -> None:
    vote = RateVote()
    assert vote.review({"cam01": 35.0, "cam02": -48.0, "cam03": 12.0}) == []


def test_a_fast_clock_among_others_is_named_once() -> None:
    vote = RateVote()
    rates = {"cam01": 12.0, "cam02": 210.0, "cam03": -20.0}
    assert vote.review(rates) == [HostOffRate("cam02", 210.0, ambiguous=False)]
    assert vote.review(rates) == []
    assert off(vote) == {"cam02": 210.0}
    assert vote.review({**rates, "cam02": 5.0}) == [HostOffRate("cam02", 0.0)]
    assert vote.off == {}


def test_where_all_nodes_agree_against_the_leader_it_is_the_leaders_clock() -> None:
    vote = RateVote()
    (news,) = vote.review({"cam01": -480.0, "cam02": -510.0, "cam03": -495.0})
    assert isinstance(news, HostOffRate)
    assert news.name is LEADER
    assert news.fast_ppm == pytest.approx(495.0, abs=20.0)
    assert not news.ambiguous


def test_of_two_clocks_the_unusual_one_is_ambiguous() -> None:
    vote = RateVote()
    assert vote.review({"cam01": 210.0}) == [HostOffRate("cam01", 210.0, ambiguous=True)]


def test_a_rate_at_the_edge_does_not_flicker() -> None:
    vote = RateVote()
    for rate, named in ((99.0, False), (101.0, True), (90.0, True), (79.0, False), (99.0, False)):
        vote.review({"cam01": rate, "cam02": 0.0})
        assert ("cam01" in vote.off) is named


def test_a_lost_node_is_not_off_rate() -> None:
    vote = RateVote()
    vote.review({"cam01": 210.0, "cam02": 0.0})
    assert vote.review({"cam02": 0.0}) == [HostOffRate("cam01", 0.0)]
