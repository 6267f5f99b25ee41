"""Videos with GoPro metadata, written after its documentation, aligned by their GPS time."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.plugins.footage.gopro import GpsClock, match_gps_clocks, read_gps_clock
from capture_app.session.format.common_times import CommonTimes
from capture_app.session.reading.reader import Session
from tests.unit.plugins.footage.cut_apart import Phone, Take
from tests.unit.plugins.footage.gpmf_tracks import Receiver, device, gps5, gps9, item, nest
from tests.unit.plugins.footage.offsets import error_ms

A = Phone("a", start_s=0.0, fps=30)
B = Phone("b", start_s=1.2345, fps=30, ppm=30, seed=2)
LATE = {"a": Receiver(0.07), "b": Receiver(0.13, seed=1)}
SECONDS = 5


def aligned(tmp_path: Path, tracks: Mapping[str, Sequence[bytes]], *arguments: str) -> CommonTimes:
    for phone in (A, B):
        path = tmp_path / "rec" / f"{phone.name}.mp4"
        phone.record(Take(), path, SECONDS, sound=False, metadata=tracks[phone.name])
    call = ["sessions", "import", str(tmp_path / "rec"), "--out", str(tmp_path), "--name", "s", *arguments]
    assert run([*call, "--times", "video", "--start", "40", "--count", "3"]) == ExitCode.OK
    times = Session.open(tmp_path / "s").manifest.burst.common_times
    assert times is not None
    return times


Track = Callable[[Receiver, Phone, int], list[bytes]]


@pytest.mark.parametrize(
    ("track", "bar_ms"), [(Receiver.gps9_track, (200, 300)), (Receiver.gps5_track, (1000, 1500))]
)
def test_gps_time_aligns_videos(tmp_path: Path, track: Track, bar_ms: tuple[float, float]) -> None:
    tracks = {phone.name: track(LATE[phone.name], phone, SECONDS) for phone in (A, B)}
    times = aligned(tmp_path, tracks)
    assert (times.state, times.reference, times.cameras["b"].source) == ("aligned", "a", "gopro")
    error, bar = error_ms(times.cameras["b"], B, 2.5)
    # One receiver's fixes arrive 60 ms later than the other's: nothing in the files tells.
    assert abs(error) < (63 if track is Receiver.gps9_track else 120)
    assert bar_ms[0] < bar < bar_ms[1]
    # So rough, it does not say which frames belong together.
    assert times.why_not_synchronized(33_333_333).startswith(
        f"not synchronized, offsets known to ± {bar:.0f} ms only"
    )
    assert not times.why_not_synchronized(3_000_000_000)


def test_it_comes_before_a_clock_that_was_set_by_hand(tmp_path: Path) -> None:
    """A GoPro's timecode is its own clock's."""
    tracks = {phone.name: LATE[phone.name].gps9_track(phone, SECONDS) for phone in (A, B)}
    for phone, code in ((A, "10:00:00:00"), (B, "10:03:00:00")):
        coded = Phone(phone.name, start_s=phone.start_s, fps=30, timecode=code)
        coded.record(
            Take(), tmp_path / "c" / f"{phone.name}.mp4", 2, sound=False, metadata=tracks[phone.name]
        )
    few = ("--times", "video", "--start", "4", "--count", "3")
    assert run(["sessions", "import", str(tmp_path / "c"), "--out", str(tmp_path), "--name", "s", *few]) == 0
    times = Session.open(tmp_path / "s").manifest.burst.common_times
    assert times is not None
    assert times.cameras["b"].source == "gopro"


def test_a_receiver_without_a_fix_tells_nothing(tmp_path: Path) -> None:
    tracks = {
        "a": LATE["a"].gps9_track(A, SECONDS),
        "b": Receiver(0.13, lock_s=100).gps9_track(B, SECONDS),
    }
    times = aligned(tmp_path, tracks, "--align", "gopro")
    assert times.unknown
    assert "b: its GPS has 0 good 3D fixes" in times.reason


def clock_of(tmp_path: Path, track: Sequence[bytes]) -> GpsClock:
    return read_gps_clock(A.record(Take(), tmp_path / "a.mp4", 1, sound=False, metadata=track))


def test_a_late_lock_costs_only_what_was_before_it(tmp_path: Path) -> None:
    clock = clock_of(tmp_path, Receiver(0.07, lock_s=3.5).gps9_track(A, 8))
    assert 3.5 <= clock.video_s[0] < 5
    assert clock.began_utc_s % 60 == pytest.approx(-0.07 % 60, abs=0.01)


def test_other_days_are_not_laid_over_each_other(tmp_path: Path) -> None:
    clocks = [
        clock_of(tmp_path, receiver.gps9_track(A, 8))
        for receiver in (Receiver(0.07), Receiver(0.07, ahead_s=86_400))
    ]
    found = match_gps_clocks(clocks[0], clocks[1])
    assert found.offset_ns is None
    assert "they are 86392.0 s apart" in found.reason


def test_a_time_lapse_is_not_aligned(tmp_path: Path) -> None:
    fast = Phone("a", fps=30, ppm=-900_000)
    with pytest.raises(BadInputError, match="time lapse"):
        clock_of(tmp_path, Receiver(0.07).gps5_track(fast, 12))


def test_long_recordings_tell_the_rate() -> None:
    rng = np.random.default_rng(4)
    utc_s = np.arange(0, 4 * 3600, 0.5)

    def clock(ppm: float, late_s: float) -> GpsClock:
        wander = 0.03 * np.sin(utc_s / 3000 + ppm)
        video_s = (utc_s + late_s + wander + rng.uniform(0, 0.01, len(utc_s))) * (1 + ppm * 1e-6)
        return GpsClock("GPS9", video_s, 8e8 + utc_s, float(video_s[-1]))

    found = match_gps_clocks(clock(25, 0.05), clock(-15, 0.1))
    assert found.rate_uncertainty_ppm is not None
    assert abs(found.rate_ppm - 40) < found.rate_uncertainty_ppm < 25


WORN = [b"2225525525425525", b"550910008224.040", b"260631100000.000", b"\xb2\xb2" + b"0" * 10 + b".000"]


def test_what_is_no_time_is_left_out(tmp_path: Path) -> None:
    good = [device(gps5(f"26060110000{second}.050".encode())) for second in range(6)]
    bad = [
        *(device(gps5(text)) for text in WORN),
        device(gps5(b"260601100010.050", dilution=600)),
        device(gps5(b"260601100011.050", fix=2)),
        device(gps5(b"260601100012.050", fixes=0)),
        good[5],
        device(gps5(b"300101000000.000")),
    ]
    clock = clock_of(tmp_path, [*good, *bad])
    assert len(clock.utc_s) == 6
    with pytest.raises(BadInputError, match="its GPS has 2 good 3D fixes"):
        clock_of(tmp_path, [*good[:2], *bad[:-2]])


def test_lengths_that_lie_are_not_believed(tmp_path: Path) -> None:
    stream = gps9(0, [])
    deep = stream
    for _ in range(50):
        deep = nest(b"DEVC", deep)
    huge = item(b"GPS9", "?", 255, 65_535, b"")
    lies = [deep, huge, device(nest(b"STRM", huge)), stream[:-5], b"DEVC\0\0\0\0" * 1000, b"\xff" * 64]
    clock = clock_of(tmp_path, [*lies, *Receiver(0.07).gps9_track(A, 3)])
    assert len(clock.utc_s) > 20
    with pytest.raises(BadInputError):
        clock_of(tmp_path, lies)
