"""Recordings whose network or machines fail meanwhile: as many instants are saved as were ordered."""

import pytest

from capture_app.node.camera.supervisor import NodeOptions
from tests.virtual.invariants import broken, sessions_of
from tests.virtual.plan import Plan, Step
from tests.virtual.rig import VirtualRig
from tests.virtual.run import run

ORDERED_S, BEGINS_S = 40.0, 25.0


def plan_of(*steps: Step, seconds: float = 70.0) -> Plan:
    return Plan(
        seed=5,
        cameras=("cam0", "cam1"),
        behind_relay=(),
        has_standby=False,
        liars={},
        drops=0.0,
        image_bytes=2000,
        wifi=False,
        steps=steps,
        seconds=seconds,
        lopsided={},
        phones=(),
        stagger="",
        has_sound=False,
    )


def record(monkeypatch: pytest.MonkeyPatch, *faults: Step) -> tuple[int, list[str]]:
    """Record for ORDERED_S with two cameras; return how many instants are saved, and what is missing."""
    saved: list[tuple[int, list[str]]] = []

    def look(rig: VirtualRig) -> list[str]:
        assert [take.result for take in rig.evidence.takes] == ["saved"]
        for of in sessions_of(rig).values():
            assert of.session is not None, of.error
            manifest = of.session.manifest
            missing = [f"{gap.camera}/{gap.instant}: {gap.reason}" for gap in manifest.missing]
            saved.append((len(manifest.burst.instants_ns), missing))
        return list(broken(rig))

    monkeypatch.setattr("tests.virtual.run.broken", look)
    steps = (Step(BEGINS_S, "recording", "desk", ORDERED_S), *faults)
    result = run(plan_of(*steps))
    assert result.failures == ()
    (recording,) = saved
    return recording


@pytest.mark.parametrize("after_s", [2.0, 30.0])
@pytest.mark.parametrize("lasts_s", [8.0, 15.0, 60.0])
@pytest.mark.parametrize("target", ["lead", "cam0"])
def test_what_is_cut_off_is_fetched_afterwards(
    monkeypatch: pytest.MonkeyPatch, target: str, lasts_s: float, after_s: float
) -> None:
    cut = Step(BEGINS_S + after_s, "cut", target, 0.0, lasts_s)
    instants, missing = record(monkeypatch, cut)
    assert instants in (399, 400)
    assert missing == []


@pytest.mark.parametrize("after_s", [2.0, 30.0])
@pytest.mark.parametrize(
    ("lasts_s", "error_s"), [(0.7, -0.7), (2.5, 0.0), (2.5, 0.9), (15.0, -15.0), (15.0, -0.9), (60.0, 0.3)]
)
def test_a_machine_that_slept_lacks_what_it_slept_through_and_says_so(
    monkeypatch: pytest.MonkeyPatch, lasts_s: float, error_s: float, after_s: float
) -> None:
    """Its clock stands still meanwhile, or goes on with an error."""
    sleep = Step(BEGINS_S + after_s, "sleep", "cam0", error_s, lasts_s)
    _, missing = record(monkeypatch, sleep)
    assert {gap.split("/")[0] for gap in missing} == {"cam0"}
    assert {gap.split(": ")[1] for gap in missing} == {"its machine slept"}
    assert len(missing) <= 10 * min(lasts_s, ORDERED_S - after_s) + 6


@pytest.mark.parametrize("lasts_s", [8.0, 60.0])
@pytest.mark.parametrize("error_s", [0.0, 0.9, -0.9])
def test_a_leader_whose_machine_slept_loses_nothing(
    monkeypatch: pytest.MonkeyPatch, lasts_s: float, error_s: float
) -> None:
    """Its clock had stood still: it refused what cameras had taken meanwhile as of a time to come."""
    instants, missing = record(monkeypatch, Step(BEGINS_S + 2, "sleep", "lead", error_s, lasts_s))
    assert missing == []
    assert instants >= 399


@pytest.mark.parametrize("how", ["kill", "power"])
def test_a_node_that_ends_in_a_cut_keeps_what_it_took_and_does_not_end_the_recording_of_the_others(
    monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    cut = Step(BEGINS_S + 10, "cut", "lead", 0.0, 15.0)
    instants, missing = record(monkeypatch, cut, Step(BEGINS_S + 17, how, "cam0", 0.0, 5.0))
    assert instants in (399, 400)
    assert {gap.split("/")[0] for gap in missing} == {"cam0"}
    assert len(missing) <= 10 * (2 + 5 + 3 + 3), "what it took until 2 s before, and again after the cut"


@pytest.mark.parametrize("how", ["kill", "power"])
@pytest.mark.parametrize("lasts_s", [1.0, 12.0])
def test_a_camera_that_is_started_again_takes_part_again(
    monkeypatch: pytest.MonkeyPatch, how: str, lasts_s: float
) -> None:
    instants, missing = record(monkeypatch, Step(BEGINS_S + 10, how, "cam0", 0.0, lasts_s))
    assert instants in (399, 400)
    assert {gap.split("/")[0] for gap in missing} == {"cam0"}
    assert len(missing) <= 10 * (lasts_s + 3), (
        "what it took while its stream was aligned is in its ring buffer"
    )


@pytest.mark.parametrize("others", [(), ("lead",)], ids=["the cameras", "and their leader"])
@pytest.mark.parametrize("lasts_s", [2.0, 3.0, 8.0])
def test_a_recording_outlives_all_its_cameras(
    monkeypatch: pytest.MonkeyPatch, lasts_s: float, others: tuple[str, ...]
) -> None:
    """As those of one machine or one hub, whose leader may be on it too."""
    all_away = [Step(BEGINS_S + 10, "kill", name, 0.0, lasts_s) for name in ("cam0", "cam1", *others)]
    instants, missing = record(monkeypatch, *all_away)
    assert instants in (399, 400)
    assert len(missing) <= 2 * 10 * (lasts_s + 3), "what they took while aligned is in their ring buffers"


@pytest.mark.parametrize("how", ["kill", "power"])
@pytest.mark.parametrize("lasts_s", [0.0, 15.0, 60.0])
def test_a_leader_that_ends_in_a_cut_fetches_what_was_ordered_of_its_next_run(
    monkeypatch: pytest.MonkeyPatch, how: str, lasts_s: float
) -> None:
    cuts = [Step(BEGINS_S + 10, "cut", "lead", 0.0, lasts_s)] if lasts_s else []
    instants, missing = record(monkeypatch, *cuts, Step(BEGINS_S + 13, how, "lead", 0.0, 4.0))
    assert instants in (399, 400)
    assert missing == []


def test_the_moves_that_keep_cameras_in_phase_are_listed_in_the_session(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A recording of two minutes by cameras that drift apart by some 20 us a second."""
    looked = []
    monkeypatch.setitem(NodeOptions.__init__.__kwdefaults__, "moves_in_recordings", True)

    def look(rig: VirtualRig) -> list[str]:
        (of,) = sessions_of(rig).values()
        assert of.session is not None, of.error
        manifest = of.session.manifest
        step_ns, moves = manifest.burst.instants_ns[1] - manifest.burst.instants_ns[0], 0
        moved_ns: dict[str, list[int]] = {}
        for camera in manifest.cameras:
            moves += len(camera.moves)
            moved_ns[camera.name] = [move.local_ns for move in camera.moves]
        for image in manifest.images:
            assert image.local_ns is not None
            near = any(0 <= at - image.local_ns <= 3 * step_ns for at in moved_ns[image.camera])
            assert near or abs(image.residual_ns) < 200_000, image
        looked.append(moves)
        return list(broken(rig))

    monkeypatch.setattr("tests.virtual.run.broken", look)
    steps = (Step(BEGINS_S, "recording", "desk", 120.0),)
    assert run(plan_of(*steps, seconds=150.0)).failures == ()
    assert looked[0] >= 4
