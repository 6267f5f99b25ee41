"""Goals that suit the cameras which cannot be moved, and bursts where frames meet."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.common.camera_facts import PhaseControl
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.phase.grid_phase_choice import (
    START_TIMEOUT_NS,
    CameraPhase,
    GridPhaseChoice,
    WeightedDrift,
    best_shift,
)
from capture_app.sync.rig.burst_orders import peak_to_peak_ns

PERIOD = 33_000_000
MS = 1_000_000
S = 1_000_000_000


@pytest.fixture
def grid_choice() -> GridPhaseChoice:
    return GridPhaseChoice(FrameGrid(0, PERIOD))


def webcam(name: str, at_ns: int | None, ppm: float = 0.0, control: str = "reset") -> CameraPhase:
    return CameraPhase(name, PhaseControl(control), at_ns, ppm, MS, name)


def test_the_grid_moves_to_the_middle_of_the_majority(grid_choice: GridPhaseChoice) -> None:
    cameras = [webcam("a", 10 * MS), webcam("b", PERIOD + 11 * MS), webcam("c", 25 * MS)]
    assert grid_choice.update(cameras, 0)
    assert grid_choice.grid == FrameGrid(10 * MS + MS // 2, PERIOD)
    assert grid_choice.common_instant_leader_ns is not None, "one of them is to be restarted"


def test_a_camera_alone_is_never_restarted(grid_choice: GridPhaseChoice) -> None:
    assert grid_choice.update([webcam("a", 14 * MS)], 0)
    assert grid_choice.grid.anchor_leader_ns == 14 * MS
    assert not grid_choice.update([webcam("a", 14 * MS)], S)
    assert grid_choice.common_instant_leader_ns is None


def test_a_camera_that_cannot_move_at_all_outweighs_all_others(grid_choice: GridPhaseChoice) -> None:
    others = [webcam(str(n), 5 * MS) for n in range(20)]
    grid_choice.update([webcam("fixed", 20 * MS, control="none"), *others], 0)
    assert abs(grid_choice.grid.phase_error(20 * MS)) <= MS


def test_a_machine_with_many_cameras_has_one_vote(grid_choice: GridPhaseChoice) -> None:
    many = [replace(webcam(str(n), 5 * MS), machine="one") for n in range(20)]
    grid_choice.update([*many, webcam("a", 20 * MS), webcam("b", 20 * MS)], 0)
    assert abs(grid_choice.grid.phase_error(20 * MS)) <= MS


def test_a_restarted_camera_keeps_its_vote_and_one_that_jumps_by_itself_has_none(
    grid_choice: GridPhaseChoice,
) -> None:
    off_grid = [webcam("a", 5 * MS), webcam("b", 5 * MS), webcam("c", 20 * MS)]
    grid_choice.update(off_grid, 0)
    grid_choice.update([*off_grid[:2], webcam("c", None)], S)
    grid_choice.update([*off_grid[:2], webcam("c", 12 * MS)], 2 * S)
    assert not grid_choice.jumps_ns
    grid_choice.update([off_grid[0], webcam("b", 15 * MS), webcam("c", 12 * MS)], 3 * S)
    assert grid_choice.jumps_ns == {"b": 10 * MS}
    grid_choice.update([off_grid[0], webcam("b", 15 * MS), webcam("c", 12 * MS)], 14 * S)
    assert not grid_choice.jumps_ns, "it is trusted again"


def test_cameras_that_inject_do_not_move_the_goal(grid_choice: GridPhaseChoice) -> None:
    assert not grid_choice.update([webcam("a", 9 * MS, control="injection")], 0)
    assert grid_choice.grid == FrameGrid(0, PERIOD)


def test_no_camera_restarts_before_all_have_reported_their_phase(grid_choice: GridPhaseChoice) -> None:
    cameras = [webcam("a", 5 * MS), webcam("b", 20 * MS), webcam("c", None)]
    assert not grid_choice.update(cameras, 0)
    assert grid_choice.common_instant_leader_ns is None
    grid_choice.update(cameras, START_TIMEOUT_NS + 1)
    assert grid_choice.common_instant_leader_ns is not None, "but not for ever"


def test_cameras_that_will_meet_are_not_restarted(grid_choice: GridPhaseChoice) -> None:
    cameras = [webcam("a", 0, ppm=100.0), webcam("b", 2500_000, ppm=-100.0)]
    grid_choice.update(cameras, 0)
    assert grid_choice.common_instant_leader_ns is not None
    for camera in cameras:
        assert camera.frame_leader_ns is not None
        later_ns = camera.drift_ppm * 1e-6 * grid_choice.common_instant_leader_ns
        assert abs(grid_choice.grid.phase_error(camera.frame_leader_ns) + later_ns) <= MS


controls = st.sampled_from([PhaseControl.RESET, PhaseControl.NONE, PhaseControl.INJECTION])
frames_ns = st.none() | st.integers(-(2**63), 2**63 - 1)
phases = st.tuples(controls, frames_ns, st.floats(), st.integers(1, 2**40))


@given(st.lists(phases, max_size=8), st.integers(-(2**62), 2**62))
def test_whatever_cameras_say_a_goal_comes_of_it(
    said: list[tuple[PhaseControl, int | None, float, int]], now_ns: int
) -> None:
    grid_choice = GridPhaseChoice(FrameGrid(0, PERIOD))
    for again in range(3):
        grid_choice.update([CameraPhase(str(n), *s, str(n % 3)) for n, s in enumerate(said)], now_ns + again)
        assert grid_choice.grid.period_ns == PERIOD


@given(st.lists(st.floats(0, 33e6, exclude_max=True), min_size=1, max_size=12))
def test_no_goal_on_a_fine_grid_suits_more_than_the_best(errors: list[float]) -> None:
    courses = [WeightedDrift(e, 0.0, MS, 1, str(n)) for n, e in enumerate(errors)]
    shift_ns, (votes, weight) = best_shift(courses, 0.0, PERIOD)
    assert votes == weight

    def suited(goal_ns: float, slack: float = 0.0) -> int:
        return sum(abs((e - goal_ns + PERIOD / 2) % PERIOD - PERIOD / 2) <= MS + slack for e in errors)

    assert suited(shift_ns, 1.0) >= weight
    assert weight >= max(suited(at, -1.0) for at in range(0, PERIOD, 250_000))


def test_frames_that_drift_meet_at_the_predicted_instant() -> None:
    grid = FrameGrid(0, PERIOD)
    forecasts = [webcam("a", 0, 20.0), webcam("b", 40_000, -20.0)]
    assert peak_to_peak_ns(grid, forecasts, grid.instant(grid.index_of(S))) < 2_000
    assert peak_to_peak_ns(grid, forecasts, 0) == pytest.approx(40_000, abs=2)
