"""A rendered scene cut apart: offsets of seconds and fractions of frames by what moves, and applied."""

from pathlib import Path

import pytest

from benchmarks.reconstruction.periodic_takes import SECOND, swing
from benchmarks.reconstruction.periodic_takes import scene as pendulum
from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.console.terminal import Progress
from capture_app.session.format.common_times import NOT_SYNCHRONIZED, CameraTimes
from capture_app.session.importing.realigning import realign_session
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import judge
from capture_app.session.reading.verify import verify
from reconstruction.method.timing import measure_pair_timing
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from reconstruction.time_offsets.motion_alignment import align_cameras
from reconstruction.time_offsets.pair_offset import PairOffsets
from tests.unit.reconstruction.conftest import Reconstruct, Scene, make_view
from tests.unit.reconstruction.time_offsets.cut_apart import Recorder, rest, write_cut_apart

LEFT = Recorder(make_view((-0.1, 0.0, 0.0), yaw=1.5), ppm=20)
NTSC = Recorder(make_view((0.1, 0.01, 0.0), yaw=-1.5), start_s=0.4621, fps=30_000 / 1001, ppm=-15)
PHONE = Recorder(make_view((0.0, -0.06, 0.0)), start_s=-0.3317, jitter_s=0.012)


def check(session: Session, cameras: dict[str, Recorder]) -> None:
    """Every image's time is right within its error, and within 1 ms."""
    assert verify(session) == []
    times = session.manifest.burst.common_times
    assert times is not None
    assert times.state == "aligned"
    assert {of.source for of in times.cameras.values()} == {"reference", "motion"}
    reference = cameras[times.reference]
    for image in session.manifest.images:
        assert image.local_ns is not None
        true_s = cameras[image.camera].true_s(image.local_ns / 1e9)
        error_ms = abs(image.leader_ns / 1e6 - reference.own_s(true_s) * 1e3)
        assert error_ms * 1e6 <= (image.uncertainty_ns or 0) + 1
        assert error_ms < 1


def test_motion_aligns_a_recording(
    scene: Scene, tmp_path: Path, reconstruct: Reconstruct, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras = {"left": LEFT, "right": NTSC}
    session = write_cut_apart(tmp_path, scene, cameras, 1.6)
    before = {(image.camera, image.local_ns): image.sha256 for image in session.manifest.images}
    assert judge(session.manifest).headline.startswith(NOT_SYNCHRONIZED)
    result = reconstruct("time", session.folder, "--apply", "--json").result
    assert result["applied"]
    assert result["cameras"]["right"]["source"] == "motion"
    aligned = Session.open(session.folder)
    check(aligned, cameras)
    assert {(image.camera, image.local_ns): image.sha256 for image in aligned.manifest.images} == before
    capsys.readouterr()
    assert run(["sessions", "show", str(session.folder)]) == ExitCode.OK
    shown = capsys.readouterr().out
    assert NOT_SYNCHRONIZED not in shown
    assert "by motion" in shown
    assert reconstruct("time", session.folder, "--apply").code == ExitCode.BAD_INPUT


def test_motion_aligns_three_cameras_of_different_rates(
    scene: Scene, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    cameras = {"left": LEFT, "right": NTSC, "phone": PHONE}
    session = write_cut_apart(tmp_path, scene, cameras, 4.0)
    assert reconstruct("time", session.folder, "--apply").code == 0
    check(Session.open(session.folder), cameras)


def test_motion_makes_a_rough_alignment_exact(scene: Scene, tmp_path: Path, reconstruct: Reconstruct) -> None:
    """As GPS gives it; neither `compare` nor `time` takes it for synchronized."""
    cameras = {"left": LEFT, "right": NTSC}
    session = write_cut_apart(tmp_path, scene, cameras, 2.0)
    rough = CameraTimes(
        offset_ns=540_000_000,
        uncertainty_ns=240_000_000,
        rate_uncertainty_ppm=140.0,
        epoch_local_ns=1_000_000_000,
        source="gopro",
    )
    reference = CameraTimes(offset_ns=0, uncertainty_ns=0, rate_uncertainty_ppm=0.0, source="reference")
    session = realign_session(session, {"left": reference, "right": rough}, "gopro")
    assert "± 240 ms only" in Dataset.open(session.folder).unsynchronized
    assert reconstruct("time", session.folder, "--apply").code == 0
    check(Session.open(session.folder), cameras)
    assert not Dataset.open(session.folder).unsynchronized


def test_where_nothing_moves_nothing_is_aligned(
    scene: Scene, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    session = write_cut_apart(tmp_path, scene, {"left": LEFT, "right": NTSC}, 1.2, path=rest)
    found = reconstruct("time", session.folder, "--json").result
    assert found["cameras"]["right"]["reason"]
    assert reconstruct("time", session.folder, "--apply").code == ExitCode.BAD_INPUT
    assert Session.open(session.folder).manifest == session.manifest


def test_pictures_that_happen_to_agree_are_not_called_synchronized(scene: Scene, tmp_path: Path) -> None:
    cameras = {"left": Recorder(LEFT.view), "right": Recorder(NTSC.view)}
    session = write_cut_apart(tmp_path, scene, cameras, 1.6)
    opened = OpenScene(Dataset.open(session.folder))
    timing = measure_pair_timing(PairOffsets(opened), ("left", "right"))
    assert timing.late_ms is not None
    assert abs(timing.late_ms) < 1
    assert not timing.synchronized
    assert NOT_SYNCHRONIZED in timing.reason


@pytest.mark.parametrize("is_broken", [False, True])
def test_a_motion_that_repeats_aligns_nothing_unless_another_breaks_its_period(
    is_broken: bool, tmp_path: Path
) -> None:
    cameras = {"left": LEFT, "right": Recorder(SECOND["above"], start_s=0.82)}
    session = write_cut_apart(tmp_path, pendulum(is_broken), cameras, 2.5, path=swing(0.7))
    found = align_cameras(OpenScene(Dataset.open(session.folder)), Progress(0, silent=True))["right"]
    timing = measure_pair_timing(PairOffsets(OpenScene(Dataset.open(session.folder))), ("left", "right"))
    if is_broken:
        assert found.offset_ns == pytest.approx(820e6, abs=1e6)
        assert timing.late_ms == pytest.approx(820, abs=1)
    else:
        assert timing.late_ms is None
        assert timing.reason == found.reason
        assert found.offset_ns is None
        assert "+120" in found.reason
        assert "+820" in found.reason
