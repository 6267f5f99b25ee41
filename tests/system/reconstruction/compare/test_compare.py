"""`reconstruct compare` from a session on disk to its folder of results."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import pytest

from capture_app.session.reading.reader import Session
from tests.project import ROOT
from tests.unit.reconstruction.compare.test_compare import overwrite
from tests.unit.reconstruction.conftest import VIEWS, Reconstruct, Scene, write_session
from tests.unit.reconstruction.found import study, values

NO_MULTIVIEW = ("--max-multiview-instants", 0)


def test_synchronization_shows_in_depth_and_panorama_but_not_in_what_stands_still(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    out = tmp_path / "out"
    done = reconstruct("compare", boards.folder, "--offset-ms", 66, *NO_MULTIVIEW, "--out", out, "--json")
    result = done.result
    assert result == json.loads((out / "metrics.json").read_text())
    assert result["offset_frames"] == 2
    stereo, panorama = study(result, "stereo"), study(result, "panorama")
    synced, offset = values(stereo), values(stereo, "offset")
    assert synced["mover_within_2pct"] > 0.9
    assert offset["mover_within_2pct"] < 0.05
    assert synced["mover_coverage"] > offset["mover_coverage"] + 0.6
    assert abs(synced["static_coverage"] - offset["static_coverage"]) < 0.02
    assert synced["mover_epipolar_px"] < 1 < offset["mover_epipolar_px"]
    assert abs(synced["static_epipolar_px"] - offset["static_epipolar_px"]) < 0.2
    flow = [values(panorama, side)["mover_misfit_px"] for side in ("synced", "offset")]
    assert flow[1] > flow[0] + 2
    late = f"{panorama['cameras'][1]}={panorama['offsets_ms'][panorama['cameras'][1]]:.4f}"
    asked = ("--pair", ",".join(panorama["cameras"]), "--condition", late, "--json")
    now = panorama["per_instant"][-1]
    at = ("--instant", int(now["instant"]), "--register-at", panorama_registered_at(panorama))
    files = reconstruct("panorama", boards.folder, *at, *asked, "--out", tmp_path / "files").result
    shutil.rmtree(tmp_path / "files")
    for side in ("synced", "offset"):
        for of_files, of_page in (("misfit", "overlap_misfit_px"), ("mover_misfit", "mover_misfit_px")):
            assert files[side][of_files]["median_px"] == now[f"{side}_{of_page}"]
    for control, slack in (("static_overlap_mad", 1), ("static_misfit_px", 0.1), ("static_found", 0.02)):
        still = [values(panorama, side)[control] for side in ("synced", "offset")]
        assert abs(still[0] - still[1]) < slack
    drawn = [picture["key"] for picture in panorama["pictures"]]
    assert drawn == ["panorama", "panorama_closeup", "panorama_overlap"]
    assert "timing alone" in result["verdict"]
    for picture in stereo["pictures"] + panorama["pictures"]:
        pair = [cv2.imread(str(out / picture[c])) for c in ("synced", "offset")]
        assert pair[0].shape == pair[1].shape
        assert min(pair[0].shape[:2]) > 64
    assert (out / result["report"]).stat().st_size > 10_000
    steps = [line for line in done.err.splitlines() if line.startswith("[")]
    assert steps[0].startswith("[1/")
    # What turned out to need no step is not counted.
    done_steps, total = steps[-1].partition("]")[0].removeprefix("[").split("/")
    assert done_steps == total
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def panorama_registered_at(panorama: dict[str, Any]) -> str:
    """The instant by which the page's command registers the images."""
    words = panorama["commands"]["synced"].split()
    return str(words[words.index("--register-at") + 1])


def test_a_damaged_file_of_true_depth_costs_only_the_studies_that_read_it(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    session = shutil.copytree(boards.folder, tmp_path / "session")
    overwrite(session, "ground_truth/left/*.npz", b"PK")
    out = tmp_path / "out"
    some = [part for name in ("stereo", "triangulation", "bullet_time") for part in ("--study", name)]
    result = reconstruct("compare", session, *some, "--max-instants", 1, "--out", out, "--json").result
    for name in ("stereo", "triangulation"):
        assert f"{session}/ground_truth/left" in study(result, name)["skipped"]
    assert not study(result, "bullet_time")["skipped"]
    assert "Not made: " in result["verdict"]
    assert (out / "report.html").exists()


def test_nothing_moving_is_said_plainly(scene: Scene, tmp_path: Path, reconstruct: Reconstruct) -> None:
    pair = {name: VIEWS[name] for name in ("left", "right")}
    session = write_session(tmp_path, scene, pair, instants=3, truth=False, frozen=True)
    out = tmp_path / "out"
    result = reconstruct("compare", session.folder, "--out", out, "--json").result
    assert result["verdict"].startswith("Almost nothing moves")
    assert "same" in study(result, "panorama")["skipped"]
    assert values(study(result, "stereo"))["static_coverage"] > 0.8
    assert "it takes 3 cameras" in study(result, "multiview")["skipped"]
    assert study(result, "poses")["skipped"]


def test_without_calibration_and_colmap_the_panorama_is_still_made(
    scene: Scene, tmp_path: Path, reconstruct: Reconstruct, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    apart = {name: VIEWS[name] for name in ("left", "aside")}
    session = write_session(tmp_path / "a", scene, apart, instants=3, calibrated=False, truth=False)
    result = reconstruct("compare", session.folder, "--out", tmp_path / "out", "--json").result
    assert "pycolmap" in study(result, "stereo")["skipped"]
    assert "pycolmap" in study(result, "multiview")["skipped"]
    assert study(result, "panorama")["cameras"] == ["left", "aside"]

    pair = {name: VIEWS[name] for name in ("left", "right")}
    session = write_session(tmp_path / "b", scene, pair, instants=3, calibrated=False, truth=False)
    done = reconstruct("compare", session.folder, "--out", tmp_path / "out2")
    assert done.code == 6
    assert "needs pycolmap" in done.err.splitlines()[-1]
    assert not (tmp_path / "out2").exists()


BUGGY = """
import os
from pathlib import Path
from reconstruction.method.interface import Check
from reconstruction.method.score import Score
from reconstruction.method.words import StudyText

class Bug(Check, frozen=True):
    name = "buggy"
    study = "buggy:Buggy"

class Buggy(Score):
    text = StudyText(name="buggy", subject="something new")
    needs = ("stereo",)

    def measure(self):
        page = Path(os.environ["PAGE"]).read_text()
        assert "Still being measured: something new" in page
        assert page.count("<img") > 3
        raise KeyError("a bug")
"""


def test_the_page_is_there_while_a_study_runs_and_says_that_it_failed(
    boards: Session, tmp_path: Path
) -> None:
    installed = tmp_path / "installed"
    (installed / "buggy-1.0.dist-info").mkdir(parents=True)
    (installed / "buggy.py").write_text(BUGGY)
    about = installed / "buggy-1.0.dist-info"
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: buggy\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[simulshot.checks]\nbuggy = buggy:Bug\n")
    out = tmp_path / "out"
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join((str(installed), str(ROOT), *sys.path)),
        "PAGE": str(out / "report.html"),
    }
    options = ("--study", "buggy", "--max-instants", "1", "--out", str(out))
    command = [sys.executable, "-m", "reconstruction.cli", "compare", str(boards.folder), *options]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stderr.count(f"first pictures, more follow: {out / 'report.html'}") == 1
    assert "something new failed: unexpected KeyError in buggy.py:20" in done.stderr
    page = (out / "report.html").read_text()
    assert "<b>Failed</b>: something new: unexpected KeyError in buggy.py:20" in page
    assert "Still being measured" not in page


def test_an_interrupt_ends_all_studies_and_leaves_nothing(boards: Session, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "reconstruction.cli", "compare", str(boards.folder), "--out", str(out)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as running:
        assert running.stdout is not None
        # Then other studies run.
        assert any(b"first pictures" in line for line in running.stdout)
        running.send_signal(signal.SIGTERM)
        assert running.wait(60) == 130
    assert list(tmp_path.iterdir()) == []


def test_the_number_of_cores_changes_nothing(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    cores = os.sched_getaffinity(0)
    if len(cores) < 2:
        pytest.skip("there is one core")

    def compare(name: str) -> tuple[Any, dict[str, bytes]]:
        out = tmp_path / name
        result = reconstruct("compare", boards.folder, "--max-instants", 3, "--out", out, "--json").result
        return result | {"seconds": 0}, {path.name: path.read_bytes() for path in out.glob("stages/*")}

    try:
        os.sched_setaffinity(0, {min(cores)})
        alone = compare("alone")
    finally:
        os.sched_setaffinity(0, cores)
    assert compare("together") == alone
