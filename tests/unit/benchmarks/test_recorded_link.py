"""The benchmark of a recorded link: what is read, and how it is replayed to simulated clocks."""

import csv
import json
import random
from pathlib import Path

import pytest

from benchmarks.clock.recorded_link import RecordedLink, main, read_trace, replay
from capture_app.common.clock import SimulatedClock
from capture_app.common.errors import BadInputError
from capture_app.companions.link.link_measurement import sum_up

MS = 1_000_000


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A WiFi link of two minutes: a message each 0.2 s, 1 ms and more under way."""
    rng, path = random.Random(4), tmp_path / "delays.csv"
    rows = [f"{i * 0.2:.1f},{1.0 + rng.gammavariate(2.0, 0.7):.4f}" for i in range(600)]
    path.write_text("\n".join(("t_s,rtt_ms", *rows)))
    return path


def test_a_recorded_link_is_replayed_to_simulated_clocks(
    recording: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["recorded_link", str(recording), "--trials", "3", "--json"])
    assert main() == 0
    first = capsys.readouterr().out
    result = json.loads(first)
    assert (result["kind"], result["trials"]) == ("simulated", 3)
    assert result["coverage_hard_bound"] == 1.0
    assert result["mean_abs_us"] < result["uncertainty_us"]
    assert main() == 0
    assert capsys.readouterr().out == first


@pytest.mark.shared
def test_a_real_recorded_link(shared: Path) -> None:
    trace = shared / "footage" / "timing" / "wifi_rtt_offset_good.csv"
    figures = sum_up(replay(trace, 300, trials=3, seed=1), kind="simulated", messages=300, seed=1)
    assert figures["coverage_hard_bound"] == 1.0
    assert figures["mean_abs_us"] < figures["uncertainty_us"]


@pytest.mark.parametrize("lost", ["nan", "inf", "-1e300"])
def test_what_is_no_round_trip_in_a_recording_is_reported(recording: Path, lost: str) -> None:
    recording.write_text(f"{recording.read_text()}\n120.0,{lost}")
    with pytest.raises(BadInputError, match="numbers that are not finite"):
        read_trace(recording, random.Random(1))


def test_a_recorded_link_is_split_into_its_two_directions(tmp_path: Path) -> None:
    path = tmp_path / "link.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("t_s", "rtt_ms"))
        for i in range(100):
            writer.writerow((i * 0.2, 3.0 if i == 50 else 2.0))
    link = read_trace(path, random.Random(1))
    ways = link.there_ns[50], link.back_ns[50]
    assert sum(ways) == pytest.approx(3.0 * MS, abs=2)
    assert min(ways) > 1.0 * MS
    assert link.there_ns[40] == link.back_ns[40] == MS


def test_a_recorded_link_is_replayed_by_the_time_in_a_loop() -> None:
    link, clock = RecordedLink((5, 6, 7), (1, 1, 1), 100_000), SimulatedClock(0, 0.0, 0)
    ways = [sample.t1_ns - sample.t0_ns for _, sample in link.exchanges(clock, 2, 4)]
    assert ways == [5, 6, 7, 5]


@pytest.mark.parametrize("text", ["", "t_s,rtt_ms\n1,2\n", "t_s,rtt_ms\n1,x\n", "t_s\n1\n"])
def test_what_is_no_recorded_link_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "link.csv"
    path.write_text(text)
    with pytest.raises(BadInputError, match=r"link\.csv"):
        read_trace(path, random.Random(1))


@pytest.mark.shared
def test_the_recording_of_a_real_link_is_read(shared: Path) -> None:
    link = read_trace(shared / "footage" / "timing" / "wifi_rtt_offset_good.csv", random.Random(1))
    assert len(link.there_ns) == 2987
    assert link.every_ns == pytest.approx(200 * MS, rel=0.05)
    assert min(link.there_ns) > 0
