"""Recordings that nothing synchronized are aligned by a panel, within their bars, or it is said why not."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest

from benchmarks.panel.photographs import draw_corners
from benchmarks.panel.recorded_takes import HEIGHT, WIDTH, Camera
from benchmarks.simulated.panel_photographs import HandheldPhotograph
from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.companions.panel.cycle_code import Cycle
from capture_app.companions.panel.light_model import Shutter
from capture_app.companions.panel.pattern import PANELS
from capture_app.companions.panel.time_reading import read_panel
from capture_app.companions.panel.visit_reading import read_visit
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.project import SAMPLES
from tests.unit.companions.panel.test_panel_alignment import photograph


def test_frames_of_a_visit_know_together_what_each_does_not() -> None:
    """A screen that draws to the right shows where it is only while it passes the lit column."""
    panel = PANELS["screen-60hz-right"]
    corners = draw_corners(panel, np.random.default_rng(5), WIDTH, HEIGHT, oblique=False)
    one = HandheldPhotograph(
        panel, WIDTH, HEIGHT, corners, 3.3e6, 16e3, defocus=0.6, jpeg_quality=None, response_ns=1e6
    )
    rng, true_s = np.random.default_rng(3), 2.0 + np.arange(8) * 0.0517
    middle_ns = one.exposure_ns / 2 + (HEIGHT - 1) / 2 * one.row_time_ns
    images = [
        (at - 1.5, replace(one, cycle=Cycle(0, 3)).take(at * 1e9 - middle_ns, rng)) for at in true_s.tolist()
    ]
    seen = sorted(read_visit(images, Shutter(8.3e6, 8.3e6 / HEIGHT), Counter()), key=lambda one: one.own_s)
    assert len(seen) == 8
    # The cells' mean delay is no error of the reading: all cameras see it.
    off_ms = [one.read.middle_ns / 1e6 - (at * 1e3 - 1.0) for one, at in zip(seen, true_s, strict=True)]
    assert np.abs(off_ms).max() < 1.0
    assert seen[0].read.uncertainty_ns < 4e6
    alone = read_panel(images[1][1], longest=Shutter(8.3e6, 8.3e6 / HEIGHT))
    assert alone.uncertainty_ns > 3 * seen[1].read.uncertainty_ns / len(seen) ** 0.5


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Camera]]:
    """Two cameras that saw a screen for a second, and one that did not."""
    folder = tmp_path_factory.mktemp("panel") / "rec"
    folder.mkdir()
    still = photograph(response_ns=2e6, rate_error=-1e-3)
    cameras = {
        "a": Camera(still, 30.0, 38.6, 12.0, (40.0,), 23, "plain", 1),
        "b": Camera(replace(still, exposure_ns=4e6), 25.0, 36.1, -20.0, (40.0,), 23, "plain", 2),
    }
    for name, camera in cameras.items():
        camera.record(folder / f"{name}.mp4")
    record_wall(folder / "c.mp4")
    return folder, cameras


def record_wall(path: Path) -> None:
    """A video of two seconds without a panel."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        for level in range(60):
            wall = np.full((240, 320, 3), 90 + level, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(wall, format="bgr24")))
        container.mux(stream.encode())


def test_videos_are_aligned_by_the_panel(
    recorded: tuple[Path, dict[str, Camera]], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, cameras = recorded
    call = ["sessions", "import", str(folder), "--out", str(folder.parent), "--name", "aligned"]
    assert run([*call, "--times", "video", "--align", "panel"]) == ExitCode.OK
    session = Session.open(folder.parent / "aligned")
    assert verify(session) == []
    said = capsys.readouterr()
    assert "c: it sees no panel" in said.out + said.err
    times = session.manifest.burst.common_times
    assert times is not None
    assert (times.state, times.reason, times.reference) == ("aligned", "by panel", "a")
    of = times.cameras["b"]
    own_ns = round(cameras["b"].own_s(40.5) * 1e9)
    error_ms = of.leader_from_local(own_ns) / 1e6 - cameras["a"].own_s(40.5) * 1e3
    assert abs(error_ms) <= (of.uncertainty_at_ns(own_ns) or 0) / 1e6
    assert abs(error_ms) < 2.0


def test_a_sessions_times_are_corrected_by_its_panel(
    recorded: tuple[Path, dict[str, Camera]], capsys: pytest.CaptureFixture[str]
) -> None:
    """It was imported with its videos' own times, of which nothing is known."""
    folder, cameras = recorded
    two = folder.parent / "two"
    two.mkdir()
    for name in cameras:
        (two / f"{name}.mp4").symlink_to(folder / f"{name}.mp4")
    call = [
        "sessions",
        "import",
        str(two),
        "--out",
        str(folder.parent),
        "--name",
        "applied",
        "--times",
        "video",
    ]
    assert run([*call, "--align", "none", "--start", "20", "--count", "50"]) == ExitCode.OK
    session = folder.parent / "applied"
    capsys.readouterr()
    assert run(["panel", "read", str(session), "--apply"]) == ExitCode.OK
    assert "b: times corrected by" in capsys.readouterr().out
    times = Session.open(session).manifest.burst.common_times
    assert times is not None
    assert (times.state, times.reason) == ("aligned", "by panel")
    for image in Session.open(session).manifest.images:
        assert image.local_ns is not None
        true_s = cameras[image.camera].true_s(image.local_ns / 1e9)
        error_ms = image.leader_ns / 1e6 - cameras["a"].own_s(true_s) * 1e3
        assert abs(error_ms) <= max(0.01, (image.uncertainty_ns or 0) / 1e6)


def test_a_captured_session_is_not_changed(capsys: pytest.CaptureFixture[str]) -> None:
    session = SAMPLES / "led_panel"
    assert run(["panel", "read", str(session), "--apply"]) == ExitCode.BAD_INPUT
    assert "was not imported" in capsys.readouterr().err
