"""Frame durations asked for, and shifts that count from a frame nobody knows."""

from dataclasses import replace

import pytest
from msgspec.structs import replace as replace_facts

from benchmarks.simulated.aligner_bench import Bench
from capture_app.common.camera_facts import PhaseControl
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.phase.actuators import Move
from capture_app.sync.phase.frame_grid import Drift, FrameGrid
from capture_app.sync.phase.injection import FINE_ROWS, FrameDurationActuator
from capture_app.sync.wire.camera_commands import SetFrameDuration
from capture_app.sync.wire.datagrams import CLOCK

ROW = 20_000
PERIOD = 1667 * ROW


def controller(min_rows: int = 800, most_rows: int = 6000) -> FrameDurationActuator:
    camera = replace_facts(
        CLOCK,
        phase_control=PhaseControl.FRAME_DURATION,
        period_ns=PERIOD,
        row_time_ns=ROW,
        min_frame_duration_ns=min_rows * ROW,
        max_frame_duration_ns=most_rows * ROW,
    )
    return FrameDurationActuator(camera)


def move(later_ns: int) -> Move:
    return Move(0, 0, later_ns % PERIOD, PERIOD, 50_000)


@pytest.mark.parametrize(
    ("later_ns", "rows"),
    [(10_000, 0), (-10_000, 0), (12_000, 1), (-12_000, -1), (3 * ROW, 3), (-200 * ROW, -200)],
)
def test_whole_rows_and_nothing_within_half_of_one(later_ns: int, rows: int) -> None:
    made = controller()
    command = made.command(move(later_ns))
    if rows == 0:
        assert command is None
        return
    assert command is not None
    assert command.duration_ns // ROW == 1667 + rows
    assert made.shift_ns == rows * ROW


def test_a_step_too_long_is_done_in_part() -> None:
    made = controller(min_rows=1600)
    command = made.command(move(-200 * ROW))
    assert command is not None
    assert command.duration_ns // ROW == 1600


def test_frames_that_cannot_be_shorter_go_round() -> None:
    made = controller(min_rows=1667)
    assert made.command(move(-200 * ROW)) is not None
    assert made.shift_ns == (1667 - 200) * ROW


def test_a_camera_without_room_is_a_problem() -> None:
    assert controller(most_rows=1667).problem
    assert not controller().problem


@pytest.mark.parametrize("latency", [(2, 4), (6, 12)])
@pytest.mark.parametrize("ppm", [-300.0, 100.0])
def test_a_fast_drift_is_held_by_a_row_for_nearly_every_frame(ppm: float, latency: tuple[int, int]) -> None:
    profile = replace(PROFILES["pi"], command_latency_frames=latency)
    bench = Bench(profile, 5, 20_000, ppm=ppm)
    bench.run(5_000_000_000)
    looks = bench.run(10_000_000_000)
    assert sum(look.aligned for look in looks) > 0.9 * len(looks)
    assert sum(abs(look.error_ns) < 20_000 for look in looks) > 0.9 * len(looks)
    assert all(abs(look.error_ns) < 30_000 for look in looks if look.aligned)


@pytest.mark.parametrize("off_ns", [150_000, -150_000])
def test_in_a_burst_a_stream_of_fine_rows_comes_back_by_small_steps(off_ns: int) -> None:
    """Five lost frames in a row take such a stream further off than one small step."""
    profile = replace(PROFILES["pi"], row_time_ns=1_000, frame_length_rows=33_333, min_frame_rows=15_000)
    bench = Bench(profile, 5, 20_000, ppm=40.0)
    bench.run(5_000_000_000)
    bench.grid = FrameGrid(bench.grid.anchor_leader_ns - off_ns, bench.grid.period_ns)
    bench.commands.clear()
    burst_ns = bench.now_ns, bench.now_ns + 3_000_000_000
    errors_ns = []
    while bench.now_ns < burst_ns[1]:
        frame = bench.next_frame()
        if not frame.dropped:
            errors_ns.append(bench.step_aligner(frame, burst_ns=burst_ns).error_ns)
    assert abs(errors_ns[0]) > 100_000
    assert max(map(abs, errors_ns[30:])) < 20_000
    for command in bench.commands:
        assert isinstance(command, SetFrameDuration)
        assert abs(command.duration_ns - profile.period_ns) <= (FINE_ROWS + 1) * profile.row_time_ns


def test_frames_that_cannot_be_shorter_are_not_made_long_in_a_burst() -> None:
    late = Drift(error_ns=5 * ROW, rate=0.0, period_ns=PERIOD, tolerance_ns=50_000, grace_ns=0.0)
    setpoint = controller(min_rows=1667).setpoint_on_hold(late)
    assert setpoint is not None
    assert setpoint.target_ns == late.error_ns, "it stays as it is"
