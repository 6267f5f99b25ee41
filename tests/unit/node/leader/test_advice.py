"""The one sentence for a whole rig: what keeps it from being ready, and what to do."""

import dataclasses
from collections.abc import Mapping

from msgspec.structs import replace

from capture_app.common.camera_facts import StampAccuracy, StampSource
from capture_app.common.node_state import NodeState
from capture_app.common.text import duration
from capture_app.node.leader.readiness import review_rates, rig_advice
from capture_app.protocol.event_text import off_rate_line
from capture_app.sync.rig.roster import Member
from capture_app.sync.timekeeping.rates import HostOffRate, RateVote
from capture_app.sync.wire.datagrams import Report
from tests.facts import make_facts

LEADER = "10.0.0.1:47010"


def view(name: str, state: NodeState = NodeState.READY, message: str = "") -> Member:
    report = Report(state=state, message=message, uncertainty_ns=41_000)
    return Member(name, 1, 1, ("10.0.0.2", 5), make_facts(), report, 0, 0.0)


def test_an_empty_rig_is_told_how_to_get_a_camera() -> None:
    assert rig_advice([], LEADER, 0) == (
        f"no camera has joined: start one with capture-app node --leader {LEADER} --camera SPEC"
    )


def test_a_ready_rig_is_told_how_sure_its_clocks_are() -> None:
    assert rig_advice([view("a"), view("b")], LEADER, 0) == "2 cameras ready, clock error ≤ 41 µs (95 %)"


def test_the_node_that_waits_for_a_person_is_named_first() -> None:
    nodes = [
        view("a", NodeState.ALIGNING, "moving its frames by 8.1 ms"),
        view("b", NodeState.FAILED, "/dev/video0 is gone"),
        view("c", NodeState.FAILED, "no frames for 5 s"),
        view("d"),
    ]
    assert rig_advice(nodes, LEADER, 0) == "b is failed: /dev/video0 is gone (and 1 more node)"
    assert rig_advice([nodes[0], nodes[3]], LEADER, 0) == "a is aligning: moving its frames by 8.1 ms"


def test_a_node_that_is_less_accurate_than_asked_for_speaks_for_itself() -> None:
    sentence = "clock error ≤ 1.7 ms, target 100 µs: bursty link; nearer the access point"
    assert rig_advice([view("a"), view("b", NodeState.DEGRADED, sentence)], LEADER, 0) == f"b: {sentence}"


def test_a_lost_camera_is_news_for_a_minute() -> None:
    lost = view("b", NodeState.LOST, "it left")
    assert rig_advice([view("a"), lost], LEADER, 0) == "b is lost: it left"
    assert (
        rig_advice([view("a"), lost], LEADER, 61_000_000_000) == "1 camera ready, clock error ≤ 41 µs (95 %)"
    )


def test_a_ready_camera_whose_images_cannot_be_sent_is_named() -> None:
    blocked = view("b", message="its images wait: no answer from 10.0.0.1:47011")
    blocked.report = replace(blocked.report, uploads_wait=True)
    assert rig_advice([view("a"), blocked, blocked], LEADER, 0) == (
        "b is ready: its images wait: no answer from 10.0.0.1:47011 (and 1 more node)"
    )
    slow = view("a", NodeState.SYNCING, "measuring clock 3/10")
    assert rig_advice([slow, blocked], LEADER, 0) == "a is syncing: measuring clock 3/10"


def test_a_ready_rig_is_told_whose_stamps_nobody_has_measured() -> None:
    webcam = make_facts(kind="v4l2", exposure_ns=4_000_000)
    unsure = dataclasses.replace(view("web"), camera=webcam)
    said = rig_advice([view("a"), unsure], LEADER, 0)
    half = duration(webcam.assumed_stamp.uncertainty_ns)
    assert said == (
        f"2 cameras ready, clock error ≤ 41 µs (95 %); stamp error of web not measured (±{half}):"
        " capture-app cameras calibrate-time measures it"
    )
    stamp = StampAccuracy(bias_ns=15_000_000, uncertainty_ns=300_000, source=StampSource.MOTION)
    measured = dataclasses.replace(unsure, camera=replace(webcam, stamp=stamp))
    said = rig_advice([view("a"), measured], LEADER, 0)
    assert said == "2 cameras ready, clock error ≤ 41 µs (95 %), timestamp error ≤ 300 µs"
    of_another = replace(stamp, against="hall", against_uncertainty_ns=20_000_000)
    joined = dataclasses.replace(unsure, camera=replace(webcam, stamp=of_another))
    assert "stamp error of web not measured except against hall (±20 ms)" in rig_advice(
        [view("a"), joined], LEADER, 0
    )


def test_a_clock_that_runs_at_another_rate_is_named_before_what_is_under_way() -> None:
    off = {"b": HostOffRate("b", -80.0), "a": HostOffRate("a", 40.0), None: HostOffRate(None, 50.0)}
    nodes = [view("a"), view("b"), view("c", NodeState.ALIGNING)]
    said = rig_advice(nodes, LEADER, 0, off)
    assert said == off_rate_line(off["b"], str) + " (and 2 more nodes)"
    assert rig_advice(nodes, LEADER, 0, {"gone": HostOffRate("gone", 40.0)}).startswith("the clock of gone")
    failed = [*nodes, view("d", NodeState.FAILED, "no frames")]
    assert rig_advice(failed, LEADER, 0, off) == "d is failed: no frames"


def test_rates_are_compared_of_nodes_whose_clocks_are_known() -> None:
    compared: list[dict[str, float]] = []

    class Vote(RateVote):
        def review(self, rates_ppm: Mapping[str, float]) -> list[HostOffRate]:
            compared.append(dict(rates_ppm))
            return [HostOffRate("a", 40.0)]

    def node(name: str, state: NodeState, skew_ppm: float | None) -> Member:
        return dataclasses.replace(view(name), report=Report(state=state, skew_ppm=skew_ppm))

    nodes = [
        node("a", NodeState.READY, 40.0),
        node("b", NodeState.SYNCING, 10.0),
        node("c", NodeState.DEGRADED, -3.0),
        node("d", NodeState.READY, None),
        node("e", NodeState.LOST, 1.0),
    ]
    assert review_rates(Vote(), nodes) == [HostOffRate("a", 40.0)]
    assert compared == [{"a": -40.0, "c": 3.0}]
