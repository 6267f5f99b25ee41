"""`reconstruct people` as a user meets it: what it writes, and one sentence for what it cannot."""

import sys
from pathlib import Path

import av
import numpy as np
import pytest

from capture_app.common.errors import ExitCode
from reconstruction import open_session
from reconstruction.methods.people import blazepose_weights
from reconstruction.methods.people.blazepose import BlazePose
from tests.project import JUMPER
from tests.system.reconstruction.methods.people.labels import INSTANTS, JOINTS, truth, write_csv
from tests.unit.reconstruction.conftest import HEIGHT, VIEWS, WIDTH, Reconstruct, Scene, write_session


def refusal(reconstruct: Reconstruct, out: Path, *arguments: object, code: ExitCode) -> str:
    """Return the sentence with which the command refuses; nothing is written."""
    done = reconstruct("people", *arguments, "--out", out)
    assert done.code == code, done.err
    assert not out.exists()
    assert "Traceback" not in done.err
    return done.complaint


def test_python_gives_arrays_with_names(tmp_path: Path) -> None:
    made = open_session(JUMPER).people(keypoints=str(write_csv(tmp_path / "labels")), out=tmp_path / "out")
    assert made.result.joints == JOINTS
    assert len(made.times_s) == INSTANTS
    assert np.abs(made.positions(1) - truth()).max() < 1e-3
    assert made.errors(1).shape == (INSTANTS, len(JOINTS))
    # What found these joints was never measured: nothing says that 95 % are within the error.
    table = (tmp_path / "out" / "people.csv").read_text()
    assert table.startswith("time_s,person,joint,x,y,z,precision_95,cameras,reprojection_px\n")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "c3d", "people.csv", "people.gltf", "people.html", "people.json", "pictures", "plots", "trc",
    ]  # fmt: skip


def test_what_is_unsure_is_a_gap_where_no_error_can_be_said(tmp_path: Path, reconstruct: Reconstruct) -> None:
    labels, out = write_csv(tmp_path / "labels"), tmp_path / "out"
    rng = np.random.default_rng(5)
    for path in labels.iterdir():
        lines = path.read_text().splitlines()
        rows = [line.split(",") for line in lines[3:]]
        for row in rows:  # the last joint is somewhere else in each camera
            row[-3:-1] = [
                str(float(x) + moved) for x, moved in zip(row[-3:-1], rng.normal(0, 80, 2), strict=True)
            ]
        path.write_text("\n".join([*lines[:3], *map(",".join, rows)]) + "\n")
    done = reconstruct("people", JUMPER, "--keypoints", labels, "--out", out)
    assert "% of these unsure: gaps in trc, c3d and people.gltf)" in done.out
    assert f",{JOINTS[-1]}," in (out / "people.csv").read_text()
    places = (out / "trc" / "person1.trc").read_text().splitlines()[6:]
    assert [line.split("\t")[-3:] for line in places] == [["", "", ""]] * INSTANTS


def test_a_film_shows_each_instant_of_each_camera(tmp_path: Path, reconstruct: Reconstruct) -> None:
    labels, out = write_csv(tmp_path / "labels"), tmp_path / "out"
    done = reconstruct("people", JUMPER, "--keypoints", labels, "--film", "--smooth", 6, "--out", out)
    assert done.code == 0, done.err
    films = sorted((out / "films").iterdir())
    assert [film.name for film in films] == [f"cam{k}.mp4" for k in ("00", "01", "04", "05", "06")]
    with av.open(str(films[0])) as film:
        assert len([*film.decode(video=0)]) == INSTANTS
    assert (out / "smoothed" / "person1.trc").is_file()


def test_compare_says_how_far_delayed_joints_are(tmp_path: Path, reconstruct: Reconstruct) -> None:
    given = "--study", "people", "--keypoints", write_csv(tmp_path / "labels")
    result = reconstruct("compare", JUMPER, *given, "--json", "--out", tmp_path / "out").result
    (study,) = (one for one in result["studies"] if one["name"] == "people")
    assert not study["reason"]
    assert "Joints of people in pictures of one instant fit the cameras to 0.0 px" in result["verdict"]
    assert "--keypoints" in study["commands"]["synced"]
    assert "Joints of people by 5 cameras" in (tmp_path / "out" / "report.html").read_text()


def test_nobody_is_refused(tmp_path: Path, reconstruct: Reconstruct, monkeypatch: pytest.MonkeyPatch) -> None:
    nobody = np.zeros((0, 33, 2)), np.zeros((0, 33))
    monkeypatch.setattr(BlazePose, "__init__", lambda detector, model: None)
    monkeypatch.setattr(BlazePose, "detect", lambda detector, image, at_s: nobody)
    said = refusal(reconstruct, tmp_path / "out", JUMPER, code=ExitCode.BAD_INPUT)
    assert "nobody is seen by cam00 or cam01" in said


def test_missing_weights_are_said_with_the_command_that_fetches_them(
    tmp_path: Path, reconstruct: Reconstruct, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(blazepose_weights, "folders", lambda: [tmp_path])
    said = refusal(reconstruct, tmp_path / "out", JUMPER, code=ExitCode.NOT_AVAILABLE)
    assert "pose_detection.tflite is not on this machine" in said
    assert "-m reconstruction.methods.people.blazepose_weights full" in said


def test_without_ezc3d_other_formats_are_written_and_c3d_is_named(
    tmp_path: Path, reconstruct: Reconstruct, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    labels, out = write_csv(tmp_path / "labels"), tmp_path / "out"
    done = reconstruct("people", JUMPER, "--keypoints", labels, "--out", out)
    assert done.code == 0, done.err
    assert "left out: C3D needs ezc3d, which is not installed" in done.err
    assert (out / "trc" / "person1.trc").is_file()
    assert not (out / "c3d").exists()


def test_a_missing_runtime_is_said_with_its_extra(
    tmp_path: Path, reconstruct: Reconstruct, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ai_edge_litert.interpreter", None)
    said = refusal(reconstruct, tmp_path / "out", JUMPER, code=ExitCode.NOT_AVAILABLE)
    assert "people" in said


@pytest.mark.parametrize(
    ("cameras", "reason"), [(("left", "right"), "no calibration"), (("left",), "one camera only (left)")]
)
def test_a_session_of_one_camera_or_without_a_calibration_is_refused(
    tmp_path: Path,
    reconstruct: Reconstruct,
    scene: Scene,
    monkeypatch: pytest.MonkeyPatch,
    cameras: tuple[str, ...],
    reason: str,
) -> None:
    grey = np.full((HEIGHT, WIDTH), 90, np.uint8)
    monkeypatch.setattr(scene, "look", lambda view, time: (grey, grey / 90, grey > 90))
    views = {name: VIEWS[name] for name in cameras}
    blank = write_session(tmp_path, scene, views, calibrated=False, truth=False)
    said = refusal(reconstruct, tmp_path / "out", blank.folder, code=ExitCode.BAD_INPUT)
    assert reason in said
