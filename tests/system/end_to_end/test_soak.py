"""A rig that takes one burst after the other does not grow: `make bench NAME=soak`, in short."""

from argparse import Namespace
from pathlib import Path

from benchmarks.endurance.slopes import growth
from benchmarks.endurance.soak import soak

BURSTS = 40


async def test_forty_bursts_leave_no_threads_memory_or_files_behind(tmp_path: Path) -> None:
    options = Namespace(cameras=2, frames=2, bursts=BURSTS, seconds=400.0, every=0.0, keep=None)
    run = await soak(options, tmp_path)
    assert run.complaints() == []
    assert {figure["kind"] for figure in run.figures()} == {"threads", "files", "memory_mb", "phase_us"}
    assert {*run.between} == {"cam1", "cam2"}
    assert run.largest_us() >= max(f["last"] for f in run.figures() if f["kind"] == "phase_us")
    # On a starved machine a node may fall silent for as long as a lost one.
    assert len(run.incomplete) < run.bursts // 2


def test_what_grows_with_each_burst_has_a_slope_and_what_fills_once_has_none() -> None:
    leaking = [(float(burst), 20.0 + 5.0 * burst) for burst in range(BURSTS)]
    filling = [(float(burst), 20.0 + min(burst, 8)) for burst in range(BURSTS)]
    jumping = [(float(burst), 20.0 + (30.0 if burst % 7 == 0 else 0.0)) for burst in range(BURSTS)]
    assert growth(leaking) > 100.0
    assert growth(filling) == 0.0
    assert abs(growth(jumping)) < 1.0
    assert growth(leaking[:1]) == 0.0
