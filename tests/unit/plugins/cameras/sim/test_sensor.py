import random
from dataclasses import replace
from itertools import pairwise
from statistics import median, pstdev

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.common.errors import BadInputError, CameraError
from capture_app.plugins.cameras.sim.profiles import PROFILES, SensorProfile, find_profile
from capture_app.plugins.cameras.sim.sensor import Sensor, SensorFrame

START_NS = 5_000_000_000_000


def sensor(profile: SensorProfile, seed: int = 1, **options: float) -> Sensor:
    made = Sensor(profile, random.Random(seed), **options)
    made.start(START_NS)
    return made


def frames(made: Sensor, count: int) -> list[SensorFrame]:
    return [made.next_frame() for _ in range(count)]


def quiet(profile: SensorProfile) -> SensorProfile:
    return replace(profile, period_error_ppm=0.0, drop_fraction=0.0)


def test_perfect_frames_are_one_period_apart_and_stamped_exactly() -> None:
    profile = PROFILES["perfect"]
    seen = frames(sensor(profile), 1000)
    assert [f.sequence for f in seen] == list(range(1000))
    assert [f.start_true_ns for f in seen] == [START_NS + k * 33_333_000 for k in range(1000)]
    assert all(f.timestamp_true_ns == f.start_true_ns and not f.dropped for f in seen)
    assert seen[0].readout_end_true_ns - START_NS == seen[0].exposure_ns + 480 * profile.row_time_ns


@given(
    name=st.sampled_from(["phone-a", "phone-b", "perfect"]),
    exposure_ns=st.integers(33_000_000, 150_000_000),
    when_ns=st.integers(-40_000_000, 40_000_000),
    seed=st.integers(0, 2**32),
)
def test_one_injection_shifts_by_gain_times_whole_rows(
    name: str, exposure_ns: int, when_ns: int, seed: int
) -> None:
    profile = quiet(PROFILES[name])
    made = sensor(profile, seed)
    last = frames(made, 20)[-1]
    made.inject(exposure_ns, last.start_true_ns + when_ns)
    after = frames(made, 20)
    rows = exposure_ns // profile.row_time_ns
    shift_ns = profile.injection_gain * profile.row_time_ns * max(0, rows - profile.neutral_rows)
    assert shift_ns == sum(profile.stretches_rows(exposure_ns)) * profile.row_time_ns
    assert after[-1].start_true_ns == last.start_true_ns + 20 * profile.period_ns + shift_ns
    long = [f for f in after if f.exposure_ns > profile.exposure_ns]
    assert [f.exposure_ns for f in long] == [rows * profile.row_time_ns]
    steps = [b.start_true_ns - a.start_true_ns for a, b in pairwise(after)]
    stretched = [step for step in steps if step != profile.period_ns]
    assert len(set(stretched)) <= 1
    assert len(stretched) == (profile.injection_gain if shift_ns else 0)


def test_a_gain_of_one_and_a_half_stretches_the_second_frame_by_half() -> None:
    profile = replace(quiet(PROFILES["phone-a"]), injection_gain=1.5)
    made = sensor(profile, 1)
    last = frames(made, 20)[-1]
    made.inject(43_360_000, last.start_true_ns)
    steps = [b.start_true_ns - a.start_true_ns - profile.period_ns for a, b in pairwise(frames(made, 20))]
    stretch_ns = (4000 - profile.neutral_rows) * profile.row_time_ns
    assert [step for step in steps if step] == [stretch_ns, stretch_ns // 2]


@pytest.mark.parametrize("cut", [True, False])
@pytest.mark.parametrize("quantum_ns", [1e6, 1e9 / 90_000, 1e3])
def test_stamps_come_in_steps(quantum_ns: float, cut: bool) -> None:
    profile = replace(
        quiet(PROFILES["phone-a"]), outlier_fraction=0.0, timestamp_quantum_ns=quantum_ns, timestamps_cut=cut
    )
    least, most = (-1.0, 0.0) if cut else (-0.5, 0.5)
    for frame in frames(sensor(profile, 2), 50):
        steps = frame.timestamp_true_ns / quantum_ns
        assert steps == pytest.approx(round(steps), abs=0.51 / quantum_ns)
        off_ns = frame.timestamp_true_ns - frame.start_true_ns
        assert least * quantum_ns - 20_000 <= off_ns <= most * quantum_ns + 20_000


def test_command_is_obeyed_two_to_four_frames_after_the_one_exposed() -> None:
    profile = quiet(PROFILES["phone-a"])
    latencies = set()
    for seed in range(40):
        made = sensor(profile, seed)
        exposed = frames(made, 10)[-1]
        made.inject(40_000_000, exposed.start_true_ns + 1_000_000)
        obeying = next(f for f in frames(made, 10) if f.exposure_ns > profile.exposure_ns)
        latencies.add(obeying.sequence - exposed.sequence)
    assert latencies == {2, 3, 4}


def test_latency_counts_from_the_frame_exposed_even_when_the_next_was_asked_for() -> None:
    profile = PROFILES["perfect"]
    made = sensor(profile)
    exposed = frames(made, 11)[-2]
    made.inject(40_000_000, exposed.start_true_ns + profile.period_ns - 1)
    assert [f.exposure_ns > profile.exposure_ns for f in frames(made, 3)] == [True, False, False]


def test_two_commands_are_both_obeyed_in_order() -> None:
    profile = quiet(PROFILES["phone-a"])
    for seed in range(20):
        made = sensor(profile, seed)
        last = frames(made, 5)[-1]
        made.inject(40_000_000, last.start_true_ns)
        made.inject(50_000_000, last.start_true_ns)
        long = [f.exposure_ns for f in frames(made, 12) if f.exposure_ns > profile.exposure_ns]
        assert [exposure // 1_000_000 for exposure in long] == [39, 49]


def test_exposures_are_clamped() -> None:
    profile = quiet(PROFILES["phone-b"])
    made = sensor(profile)
    made.inject(10**12, START_NS)
    longest = max(f.exposure_ns for f in frames(made, 10))
    assert profile.max_exposure_ns - profile.row_time_ns < longest <= profile.max_exposure_ns


def test_same_seed_same_frames_and_a_command_changes_no_noise() -> None:
    profile = PROFILES["phone-a"]
    one, other, injected, stranger = sensor(profile), sensor(profile), sensor(profile), sensor(profile, 2)
    injected.inject(50_000_000, START_NS)
    first, commanded = frames(one, 500), frames(injected, 500)
    assert first == frames(other, 500)
    assert first != frames(stranger, 500)
    noise = [(f.timestamp_true_ns - f.start_true_ns, f.dropped) for f in first]
    assert noise == [(f.timestamp_true_ns - f.start_true_ns, f.dropped) for f in commanded]


def test_crystals_differ_and_stay_within_the_profile() -> None:
    profile = PROFILES["phone-a"]
    errors = [sensor(profile, seed).period_error_ppm for seed in range(50)]
    assert max(map(abs, errors)) <= 20
    assert pstdev(errors) > 5


def test_crystal_drifts_in_true_time_without_adding_up_rounding() -> None:
    made = sensor(PROFILES["perfect"], period_error_ppm=-12.5)
    last = frames(made, 20_001)[-1]
    elapsed_ns = 20_000 * 33_333_000
    assert last.start_true_ns - START_NS == elapsed_ns - elapsed_ns * 125 // 10**7


def test_noise_outliers_and_drops_as_configured() -> None:
    profile = replace(PROFILES["phone-a"], drop_fraction=0.1, outlier_fraction=0.05)
    seen = frames(sensor(profile), 4000)
    errors = [f.timestamp_true_ns - f.start_true_ns for f in seen]
    good = [e for e in errors if abs(e) < 5 * profile.timestamp_noise_ns]
    assert abs(median(good)) < 300
    assert pstdev(good) == pytest.approx(3000, rel=0.1)
    assert 0.03 < 1 - len(good) / len(errors) < 0.07
    assert max(errors) < profile.outlier_ns + 5 * profile.timestamp_noise_ns
    assert 0.08 < sum(f.dropped for f in seen) / len(seen) < 0.12


def test_restart_is_a_new_stream_at_a_new_phase_and_forgets_commands() -> None:
    made = sensor(PROFILES["perfect"])
    frames(made, 7)
    made.inject(60_000_000, START_NS)
    made.stop()
    made.start(START_NS + 10**9)
    seen = frames(made, 10)
    assert (seen[0].stream, seen[0].sequence, seen[0].start_true_ns) == (1, 0, START_NS + 10**9)
    assert {f.exposure_ns for f in seen} == {seen[0].exposure_ns}
    assert made.stream == 1


def test_webcam_starts_within_250_to_300_ms_and_cannot_inject() -> None:
    made = sensor(PROFILES["webcam"])
    latencies = []
    for k in range(200):
        made.stop()
        made.start(START_NS + k * 10**9)
        latencies.append((made.next_frame().start_true_ns - START_NS - k * 10**9) / 1e6)
    assert min(latencies) >= 250
    assert max(latencies) <= 300
    assert pstdev(latencies) > 2
    with pytest.raises(CameraError, match="cannot inject"):
        made.inject(40_000_000, START_NS)


def test_a_stopped_sensor_gives_nothing() -> None:
    made = sensor(PROFILES["perfect"])
    with pytest.raises(CameraError, match="already"):
        made.start(START_NS)
    made.stop()
    made.stop()
    assert not made.streaming
    with pytest.raises(CameraError):
        made.next_frame()
    with pytest.raises(CameraError):
        made.inject(40_000_000, START_NS)


def test_all_profiles_have_one_period_and_read_out_in_about_5_ms() -> None:
    assert {profile.period_ns for profile in PROFILES.values()} == {33_333_000}
    for profile in PROFILES.values():
        assert 4.5e6 < profile.image_rows * profile.row_time_ns < 6e6
        assert profile.exposure_ns < profile.neutral_rows * profile.row_time_ns
    assert PROFILES["phone-a"].injection_gain != PROFILES["phone-b"].injection_gain


@pytest.mark.parametrize("exposure_ns", [40_000_000, 10])
def test_impossible_exposures_are_refused(exposure_ns: int) -> None:
    with pytest.raises(BadInputError):
        replace(PROFILES["phone-a"], exposure_ns=exposure_ns)


def test_unknown_profile_lists_those_there_are() -> None:
    with pytest.raises(BadInputError, match="phone-a, phone-b, pi, webcam, perfect"):
        find_profile("phone-z")
