"""Lenses that are given are doubted: points at rest confirm them, contradict them, or say nothing."""

import re
import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

from capture_app.board.boards import DEFAULT_BOARD
from capture_app.session.format.calibration import Calibration, LensKnowledge
from capture_app.session.format.manifest import MANIFEST
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import View
from reconstruction.scene import calibration_run
from reconstruction.scene.calibration.board_calibration import count_coverage
from reconstruction.scene.calibration.consistency import (
    check_rig,
    judge_focal_lengths,
)
from reconstruction.scene.calibration.stored import keep_calibration
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.pairs import Features
from reconstruction.scene.scene import Scene
from tests.unit.reconstruction.conftest import Reconstruct, make_view, write_session
from tests.unit.reconstruction.conftest import Scene as Rendered
from tests.unit.reconstruction.scene.calibration.test_kept_calibration import (  # noqa: F401 - fixtures
    RIG,
    bare,
    calibration,
    features,
    turned,
)

Still = dict[str, Features]
FOCAL_PX = RIG["a"].focal


def zoomed(factor: float, *names: str) -> dict[str, View]:
    return {name: view.magnified(factor) if name in names else view for name, view in RIG.items()}


def check_figures(text: str, name: str, factor: float) -> None:
    """The text has a camera's wrong focal length and, with its error, the right one."""
    said = rf"gives {name} a focal length of (\d+) px, and points at rest say (\d+) ± (\d+) px"
    found = re.search(said, text)
    assert found is not None, text
    given_px, right_px, error_px = map(int, found.groups())
    assert given_px == round(factor * FOCAL_PX)
    assert abs(right_px - FOCAL_PX) <= error_px + 0.5
    assert error_px <= 0.02 * FOCAL_PX


def test_right_lenses_are_confirmed(features: Still) -> None:  # noqa: F811
    check = check_rig(RIG, features)
    assert (check.confirms_lenses, check.by_lenses, check.holds) == (True, "", True)


@pytest.mark.parametrize(("factor", "names"), [(1.2, "abcd"), (0.8, "abcd"), (1.2, "a"), (0.85, "c")])
def test_a_wrong_focal_length_is_said_with_both_figures(
    features: Still,  # noqa: F811
    factor: float,
    names: str,
) -> None:
    check = check_rig(zoomed(factor, *names), features)
    check_figures(check.by_lenses, names[0], factor)
    assert ("the others" in check.by_lenses) == (len(names) > 1)
    assert (check.moved, check.holds, check.confirms_lenses and len(names) > 1) == ((), False, False)


@pytest.mark.parametrize("turn", [{"pitch_px": 5.0}, {"yaw_px": 6.0}, {"pitch_px": 1.0}])
def test_no_lens_explains_a_turned_camera(features: Still, turn: dict[str, float]) -> None:  # noqa: F811
    check = check_rig({**RIG, "c": turned(RIG["c"], **turn)}, features)
    assert check.by_lenses == ""


def test_nobody_moved_where_doubtful_lenses_explain_it(features: Still) -> None:  # noqa: F811
    views = {**RIG, "c": turned(RIG["c"], pitch_px=5.0)}
    doubtful = LensKnowledge(level="not", why="off by up to 1.8 to 13 % (95 %)")
    check = check_rig(views, features, doubtful)
    assert (check.moved, check.holds) == ((), False)
    assert str(check).startswith("points at rest miss c by ")
    assert str(check).endswith("off by up to 1.8 to 13 % (95 %)")
    far = check_rig({**RIG, "c": turned(RIG["c"], pitch_px=30.0)}, features, doubtful)
    assert "c moved" in str(far)


@pytest.mark.parametrize("second", [make_view((0.1, 0.0, 0.0)), make_view((-0.1, 0.0, 0.0), yaw=2)])
@pytest.mark.parametrize("factor", [1.0, 1.2])
def test_parallel_cameras_and_those_at_one_place_say_nothing(second: View, factor: float) -> None:
    rng = np.random.default_rng(0)
    pair = {"a": make_view((-0.1, 0.0, 0.0)), "b": second}
    points = rng.uniform((-1, -1, 3), (1, 1, 5), (300, 3))
    at = [view.project(points @ view.rotation.T + view.translation) for view in pair.values()]
    pixels = np.stack(at) + rng.normal(0, 0.1, (2, 300, 2))
    views = {name: view.magnified(factor) for name, view in pair.items()}
    assert judge_focal_lengths(views, {("a", "b"): pixels}, ("a", "b"), 0.3) == ("", False)


@pytest.fixture
def wrong(bare: Session, tmp_path: Path) -> Path:  # noqa: F811
    """A file with focal lengths that are 20 % too long."""
    path = tmp_path / "calibration.json"
    path.write_bytes(msgspec.json.encode(calibration(zoomed(1.2, *RIG))))
    return path


def test_every_door_refuses_what_the_pictures_contradict(
    bare: Session,  # noqa: F811
    wrong: Path,
    reconstruct: Reconstruct,
) -> None:
    given = reconstruct("calibrate", bare.folder, "--from", wrong)
    assert given.code != 0
    check_figures(given.complaint, "a", 1.2)
    assert not (bare.folder / "calibration.json").exists()


def test_a_comparison_refuses_its_session_s_wrong_lenses(
    bare: Session,  # noqa: F811
    wrong: Path,
    tmp_path: Path,
    reconstruct: Reconstruct,
) -> None:
    folder = shutil.copytree(bare.folder, tmp_path / "session")
    shutil.copy(wrong, folder / "calibration.json")
    given = reconstruct(
        "compare", folder, "--offset-ms", "33", "--study", "stereo", "--out", tmp_path / "out"
    )
    assert given.code != 0
    assert "does not hold for its pictures: the calibration gives a" in given.complaint
    check_figures(given.complaint, "a", 1.2)


def test_compare_judges_another_sessions_calibration_too(
    bare: Session,  # noqa: F811
    tmp_path: Path,
    reconstruct: Reconstruct,
) -> None:
    right, wrong = (shutil.copytree(bare.folder, tmp_path / name) for name in ("right", "wrong"))
    for folder, views in ((right, RIG), (wrong, zoomed(1.2, *RIG))):
        (folder / "calibration.json").write_bytes(msgspec.json.encode(calibration(views)))
    given = reconstruct(
        *("compare", right, "--against", wrong, "--offset-ms", "33", "--study", "stereo"),
        *("--out", tmp_path / "out"),
    )
    assert given.code != 0
    assert "does not hold for its pictures: the calibration gives a" in given.complaint
    assert f"reconstruct calibrate {wrong} --replace" in given.complaint


def test_a_kept_calibration_with_wrong_lenses_is_not_used(
    bare: Session,  # noqa: F811
    capsys: pytest.CaptureFixture[str],
) -> None:
    keep_calibration(Dataset(bare), calibration(zoomed(1.2, *RIG)))
    assert Scene.open(bare.folder).given is None
    check_figures(capsys.readouterr().err, "a", 1.2)


def test_an_import_takes_no_kept_calibration(bare: Session, tmp_path: Path) -> None:  # noqa: F811
    keep_calibration(Dataset(bare), calibration(RIG))
    imported = msgspec.structs.replace(bare.manifest, origin="imported")
    folder = shutil.copytree(bare.folder, tmp_path / "imported")
    for manifest, takes in ((bare.manifest, True), (imported, False)):
        (folder / MANIFEST).write_bytes(msgspec.json.encode(manifest))
        assert (Scene.open(folder).given is not None) == takes


@pytest.mark.parametrize(("views", "is_refused"), [(zoomed(1.2, *RIG), True), (RIG, False)])
def test_a_board_is_no_better_witness(
    bare: Session,  # noqa: F811
    tmp_path: Path,
    reconstruct: Reconstruct,
    monkeypatch: pytest.MonkeyPatch,
    views: dict[str, View],
    is_refused: bool,
) -> None:
    """What the board gave is judged by the points at rest of the same pictures."""
    folder = shutil.copytree(bare.folder, tmp_path / "session")
    by_board = calibration_run._Candidate(
        calibration=calibration(views),
        shared=calibration_run._still_points(Scene.open_raw(folder).features.middle, views),
        board=count_coverage(Dataset(bare), DEFAULT_BOARD, {}),
    )
    monkeypatch.setattr(calibration_run, "_from_board", lambda *given: by_board)
    outcome = reconstruct("calibrate", folder, "--from", "board")
    assert (folder / "calibration.json").exists() != is_refused
    if is_refused:
        check_figures(outcome.complaint, "a", 1.2)


def opened(session: Session, root: Path, views: dict[str, View], origin: str) -> Scene:
    """The scene of a session with another calibration and origin."""
    folder = shutil.copytree(session.folder, root / "session")
    manifest = msgspec.structs.replace(session.manifest, origin=origin)
    (folder / MANIFEST).write_bytes(msgspec.json.encode(manifest))
    (folder / "calibration.json").write_bytes(msgspec.json.encode(calibration(views)))
    return Scene.open(folder)


def test_contradicted_lenses_give_no_verdict_and_no_confidence(bare: Session, tmp_path: Path) -> None:  # noqa: F811
    check_figures(opened(bare, tmp_path, zoomed(1.2, *RIG), "imported").lenses.doubt(), "a", 1.2)


def test_confirmed_lenses_of_an_import_are_believed(bare: Session, tmp_path: Path) -> None:  # noqa: F811
    assert not opened(bare, tmp_path, RIG, "imported").lenses.doubt(rough=True)


@pytest.mark.parametrize(("origin", "level"), [("imported", "roughly"), ("simulated", "well")])
def test_unconfirmed_lenses_of_a_file_are_known_roughly(tmp_path: Path, origin: str, level: str) -> None:
    blank = write_session(tmp_path, Rendered([]), RIG, instants=1, calibrated=False, truth=False)
    assert opened(blank, tmp_path, RIG, origin).lenses.level == level


def test_nothing_is_said_of_lenses_of_other_cameras(bare: Session) -> None:  # noqa: F811
    others = Calibration(cameras={"other": RIG["a"].to_calibration()}, unit="m", source="elsewhere")
    scene = Scene(Dataset(bare), others)
    assert "the calibration is of other cameras" in scene.problem
    assert scene.lenses == LensKnowledge()
