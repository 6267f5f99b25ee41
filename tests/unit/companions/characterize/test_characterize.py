"""What is measured of simulated cameras, whose every property is known; in stepped time."""

import random
from pathlib import Path
from statistics import median

import pytest
from msgspec.structs import replace

from capture_app.common.camera_facts import CameraFacts
from capture_app.common.errors import CameraError
from capture_app.companions.characterize.camera_character import Character, characterize, common_step, save
from capture_app.node.camera.device_profiles import DeviceProfiles, mode_key
from capture_app.plugins.cameras.sim.profiles import PROFILES
from tests.unit.plugins.cameras.sim.simulation_driver.stepped import LoopClock, in_stepped_time

pytestmark = pytest.mark.virtual


@in_stepped_time
async def measured(spec: str, *, seconds: float = 10.0, starts: int = 0, moves: int = 0) -> Character:
    return await characterize(
        spec, seconds=seconds, starts=starts, moves=moves, keep=False, talk=lambda _: None, clock=LoopClock(7)
    )


def test_a_webcam_is_watched_and_restarted() -> None:
    found = measured("sim:webcam,ppm=25,noise_us=40,drops=0", starts=8)
    assert found.rate_error_ppm == pytest.approx(-25, abs=3)
    assert 30_000 < found.stamp_jitter_ns < 50_000
    assert (found.stamp_step_ns, found.drops, found.moves) == (0, 0, None)
    assert found.exposures_ns == (found.camera.exposure_ns, found.camera.exposure_ns)
    # From the end of the readout on a frame is delivered within 2 to 4 ms.
    readout_ns = (found.camera.exposure_ns or 0) + 480 * 10_250
    assert readout_ns + 1_500_000 < found.delivery_ns < readout_ns + 4_500_000
    assert found.starts is not None
    assert found.starts.by_restart
    assert median(found.starts.latencies_ns) == pytest.approx(275e6, abs=8e6)
    assert 3e6 < max(found.starts.latencies_ns) - min(found.starts.latencies_ns) < 40e6


def test_drops_are_counted() -> None:
    assert measured("sim:perfect,drops=0.1,seed=2").drops > 10


@pytest.mark.parametrize(("model", "gain"), [("phone-a", 2.0), ("phone-b", 1.0)])
def test_rows_gain_and_overhead_of_injections_are_found(model: str, gain: float) -> None:
    profile = PROFILES[model]
    moves = measured(f"sim:{model}", moves=20, seconds=3).moves
    assert moves is not None
    assert moves.injection is not None
    assert (moves.injection.gain, moves.injection.neutral_rows) == (gain, profile.neutral_rows)
    assert moves.overhead_ns == profile.margin_rows * profile.row_time_ns
    assert moves.row_time_ns == pytest.approx(profile.row_time_ns, rel=1e-3)
    assert moves.latency_frames is not None
    assert moves.latency_frames[0] >= 2


def test_rows_show_in_frame_durations() -> None:
    moves = measured("sim:pi", moves=10, seconds=3).moves
    assert moves is not None
    assert moves.row_time_ns == pytest.approx(11_111, rel=1e-3)
    assert moves.injection is None


def test_rows_that_noise_hides_are_not_guessed() -> None:
    moves = measured("sim:pi,noise_us=50", moves=10, seconds=3).moves
    assert moves is not None
    assert (moves.row_time_ns, moves.effective) == (None, 10)
    assert "scatter too much" in moves.reason


@pytest.mark.parametrize("seed", range(6))
def test_a_common_step_is_found_or_none_is_claimed(seed: int) -> None:
    rng = random.Random(seed)
    step_ns = rng.uniform(5_000, 60_000)
    shifts = [step_ns * rng.randint(100, 150) + rng.gauss(0, 700) for _ in range(20)]
    found = common_step(shifts, 700)
    assert found == pytest.approx(step_ns, rel=1e-3)
    assert common_step([rng.uniform(1e6, 2e6) for _ in range(20)], 700) is None
    assert common_step(shifts[:5], 700) is None


@in_stepped_time
async def test_a_camera_without_frames_is_an_error_in_words() -> None:
    spec, clock = "sim:perfect,drops=1", LoopClock(7)
    with pytest.raises(CameraError, match="delivered no frames for 15 s"):
        await characterize(spec, seconds=1.0, starts=0, moves=0, keep=False, talk=lambda _: None, clock=clock)


def kept(folder: Path, facts: CameraFacts) -> tuple[object, int]:
    known = DeviceProfiles(folder).read(mode_key(facts))
    return known.usable_injection, len(known.start_latencies_ns)


def test_what_nodes_use_is_kept(tmp_path: Path) -> None:
    webcam = measured("sim:webcam", seconds=2, starts=3)
    assert save(webcam, DeviceProfiles(tmp_path)).saved
    assert kept(tmp_path, webcam.camera) == (None, 3)
    phone = measured("sim:phone-a", seconds=2, moves=3)
    assert save(phone, DeviceProfiles(tmp_path)).saved
    assert phone.moves is not None
    assert kept(tmp_path, phone.camera) == (phone.moves.injection, 0)
    other = replace(phone, moves=None)
    assert not save(other, DeviceProfiles(tmp_path)).saved
