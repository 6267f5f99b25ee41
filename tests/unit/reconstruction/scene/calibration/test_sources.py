"""Where a session's calibration comes from, how it is scaled, and what is said of it."""

import os
import shutil
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import Manifest
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import View
from reconstruction.scene import calibration_run
from reconstruction.scene.calibration.board_calibration import BoardCorners
from reconstruction.scene.calibration.consistency import CalibrationCheck
from reconstruction.scene.calibration.stored import (
    camera_modes,
    describe_check,
    find_calibration,
    find_rig_views,
    keep_calibration,
    known_calibration,
    write_calibration,
)
from reconstruction.scene.calibration_run import (
    CalibrateOptions,
    CalibrationSource,
    calibrate,
    cover,
    open_recordings,
    read_calibration,
)
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from tests.unit.reconstruction.conftest import make_view, write_session
from tests.unit.reconstruction.scene.calibration.test_kept_calibration import RIG, ROOM, calibration, turned
from tests.unit.reconstruction.scene.calibration.test_kept_calibration import bare as bare

ENDS = np.array([[-0.5, 0.2, 3.4], [0.6, -0.1, 3.0]])
"""Two points in the rig's frame, the first below the second by 0.3."""


def pixels(view: View, points: Any = ENDS) -> Any:
    return tuple(map(tuple, view.project(points @ view.rotation.T + view.translation)))


MARKS = {name: pixels(RIG[name]) for name in ("a", "d")}


def copy_of(session: Session, folder: Path, known: Calibration | None = None, **changes: Any) -> Path:
    """A copy of a session with this calibration, and changes of its manifest."""
    shutil.copytree(session.folder, folder)
    if changes:
        manifest = msgspec.structs.replace(session.stored_manifest, **changes)
        (folder / "session.json").write_bytes(msgspec.json.encode(manifest))
    if known is not None:
        write_calibration(folder / "calibration.json", known)
    return folder


def rescaled(bare: Session, **options: Any) -> Calibration:
    dataset = Dataset(bare)
    return calibration_run._rescaled(dataset, calibration(RIG, "arbitrary"), CalibrateOptions(**options))


def test_a_distance_between_marks_sets_the_unit(bare: Session) -> None:
    found = rescaled(bare, distance=(MARKS, 3 * float(np.linalg.norm(ENDS[1] - ENDS[0]))))
    assert (found.unit, found.source[:26]) == ("m", "a board; scale from a dist")
    assert found.cameras["d"].translation == pytest.approx(tuple(3 * RIG["d"].translation), rel=1e-3)
    assert found.cameras["d"].rotation == calibration(RIG).cameras["d"].rotation


def test_two_points_one_above_the_other_set_the_ground(bare: Session) -> None:
    foot, head = np.array([0.1, 0.8, 3.0]), np.array([0.1, -0.2, 3.0])
    marks = {name: pixels(RIG[name], np.array([foot, head])) for name in ("a", "d")}
    found = rescaled(bare, vertical=marks)
    assert (found.unit, found.source) == (
        "arbitrary",
        "a board; z up, ground by two points one above the other",
    )
    for name, view in RIG.items():
        camera = View.from_calibration(found.cameras[name], 320, 240)
        assert camera.centre[2] == pytest.approx(foot[1] - view.centre[1], abs=0.02)
        # The first camera's axis is ahead: along y.
        assert camera.axis[2] == pytest.approx(0, abs=0.02)
    first = View.from_calibration(found.cameras["a"], 320, 240)
    assert first.axis == pytest.approx([0, 1, 0], abs=0.02)


class Board:
    """A board whose corners are at places in the rig, at two instants."""

    places = np.array([[x, y, 0.0] for y in range(4) for x in range(5)]) * 0.1
    shape = "6x5"

    def corners(self, unit: float, into: Any) -> BoardCorners:
        points = into(self.places) / unit
        return {
            (name, k): {n: np.array(at) for n, at in enumerate(pixels(RIG[name], points))}
            for k in (0, 1)
            for name in ("a", "d")
        }


def test_a_board_in_the_scene_or_on_the_ground_sets_unit_and_world(
    bare: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    board, opened = Board(), list[Any]()
    metre = 0.5

    def facing(places: Any) -> Any:
        return places + np.array([-0.2, -0.1, 1.5])

    def detected(recordings: Any, asked: Any) -> Any:
        assert asked is board
        opened.append([recording.name for recording in recordings])
        return corners

    monkeypatch.setattr(calibration_run, "detect_board", detected)
    corners = board.corners(metre, facing)
    # Some corners are hidden from one of the two.
    for k in (0, 1):
        for number in (0, 7, 13):
            del corners["d", k][number]
    found = rescaled(bare, scale_by_board=True, board=board)
    assert (found.unit, found.source) == ("m", "a board; scale from a board, at 2 instants")
    assert found.cameras["d"].translation == pytest.approx(tuple(metre * RIG["d"].translation), rel=0.01)

    def lying(places: Any) -> Any:
        x, y, _ = places.T
        return np.column_stack([x - 0.2, np.full(len(x), 0.4), 2.0 - y])

    corners = board.corners(metre, lying)
    found = rescaled(bare, ground=bare.folder, board=board)
    assert (found.unit, found.source) == (
        "m",
        "a board; z up, ground by a board on it in boards, at 2 instants",
    )
    heights = [View.from_calibration(camera, 320, 240).centre[2] for camera in found.cameras.values()]
    assert heights == pytest.approx([0.4 - metre * view.centre[1] for view in RIG.values()], abs=0.02)
    assert opened == [["boards"], ["boards"]]


def candidate(session: Path, source: CalibrationSource | Path) -> Calibration:
    return calibration_run._from_elsewhere(OpenScene.open_raw(session), source).calibration


def test_a_calibration_is_of_the_session_its_rig_or_another_session(bare: Session, tmp_path: Path) -> None:
    own = calibration(RIG)
    with pytest.raises(BadInputError, match="boards has no calibration of its own"):
        candidate(bare.folder, CalibrationSource.SESSION)
    with pytest.raises(
        BadInputError, match="no calibration is kept of these cameras in these modes: a 320x240, b"
    ):
        candidate(bare.folder, CalibrationSource.STORED)
    session = copy_of(bare, tmp_path / "own", own)
    assert candidate(session, CalibrationSource.SESSION) == own
    keep_calibration(Dataset(bare), own)
    assert candidate(bare.folder, CalibrationSource.STORED).source.startswith("a board, kept from boards of ")


def test_another_sessions_calibration_is_taken_with_its_name_and_has_no_fault(
    bare: Session, tmp_path: Path
) -> None:
    other = calibration(RIG, "arbitrary")
    given = candidate(bare.folder, copy_of(bare, tmp_path / "other", other))
    assert (given.unit, given.source) == ("arbitrary", "a board, given by boards")
    broken = calibration(RIG | {"a": make_view((0, 0, 0))})
    odd = msgspec.structs.replace(broken.cameras["a"], fx=-1.0)
    broken = msgspec.structs.replace(broken, cameras=broken.cameras | {"a": odd})
    with pytest.raises(BadInputError, match="a"):
        candidate(bare.folder, copy_of(bare, tmp_path / "broken", broken))


def test_another_sessions_cameras_have_to_be_in_the_same_mode(bare: Session, tmp_path: Path) -> None:
    dataset = Dataset(bare)
    with pytest.raises(BadInputError, match="has no calibration to give"):
        read_calibration(dataset, bare.folder)
    unnamed = msgspec.structs.replace(calibration(RIG), source="")
    assert (
        read_calibration(dataset, copy_of(bare, tmp_path / "u", unnamed)).source == "unknown, given by boards"
    )
    cameras = bare.stored_manifest.cameras
    facts = msgspec.structs.replace(cameras[1].facts, model="another")
    changed = (cameras[0], msgspec.structs.replace(cameras[1], facts=facts), *cameras[2:])
    other = copy_of(bare, tmp_path / "mode", calibration(RIG), cameras=changed)
    with pytest.raises(
        BadInputError, match=r"b is not the same camera in the same mode: .* in boards, another"
    ):
        read_calibration(dataset, other)
    # Imports know no models: of images of one size it is the same.
    imported = copy_of(bare, tmp_path / "import", calibration(RIG), cameras=changed, origin="imported")
    assert read_calibration(dataset, imported).cameras.keys() == RIG.keys()
    wide = msgspec.structs.replace(facts, width=640)
    changed = (cameras[0], msgspec.structs.replace(cameras[1], facts=wide), *cameras[2:])
    larger = copy_of(bare, tmp_path / "larger", calibration(RIG), origin="imported")
    manifest = msgspec.json.decode((larger / "session.json").read_bytes(), type=Manifest)
    other_size = msgspec.structs.replace(manifest, cameras=changed)
    monkeyed = Session(larger, other_size)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration_run, "_opened", lambda paths: [Dataset(monkeyed)])
        with pytest.raises(BadInputError, match="another 640x240"):
            read_calibration(dataset, larger)


def test_recordings_of_a_board_are_by_the_same_cameras(bare: Session, tmp_path: Path) -> None:
    dataset = Dataset(bare)
    assert open_recordings(dataset, ()) == [dataset]
    (opened,) = open_recordings(dataset, (bare.folder,))
    assert opened.cameras == dataset.cameras
    pair = {name: RIG[name] for name in ("a", "b")}
    two = write_session(tmp_path, ROOM, pair, instants=1, truth=False)
    with pytest.raises(BadInputError, match=r"boards was taken by other cameras \(a, b\)") as refused:
        open_recordings(dataset, (two.folder,))
    assert refused.value.hint == "give recordings by the cameras of boards: a, b, c, d"


def test_a_calibration_that_is_stored_is_judged_and_kept_as_asked(bare: Session, tmp_path: Path) -> None:
    given = copy_of(bare, tmp_path / "given", calibration(RIG))
    session = copy_of(bare, tmp_path / "session")
    result = calibrate(session, CalibrateOptions(source=given, keep=True))
    assert (result.stored, result.kept, result.missing, result.unit) == (True, True, (), "m")
    assert result.cameras == ("a", "b", "c", "d")
    assert result.check is not None
    assert result.check.holds
    assert result.board is None
    stored = Session.open(session).calibration()
    assert stored is not None
    assert stored.source == result.source == "a board, given by boards"
    with pytest.raises(BadInputError, match="has a calibration already"):
        calibrate(session, CalibrateOptions(source=given))


def test_a_sessions_own_calibration_is_judged_and_neither_written_nor_kept(
    bare: Session, tmp_path: Path
) -> None:
    session = copy_of(bare, tmp_path / "session", calibration(RIG))
    before = (session / "calibration.json").stat().st_mtime_ns
    own = calibrate(session, CalibrateOptions(source=CalibrationSource.SESSION))
    assert (own.stored, own.kept) == (False, False)
    assert (session / "calibration.json").stat().st_mtime_ns == before


def test_a_calibration_that_does_not_hold_is_not_stored(bare: Session, tmp_path: Path) -> None:
    moved = calibration(RIG | {"a": turned(RIG["a"], pitch_px=6.0)})
    wrong = copy_of(bare, tmp_path / "wrong", moved)
    with pytest.raises(BadInputError, match="does not hold for these pictures: a "):
        calibrate(copy_of(bare, tmp_path / "third"), CalibrateOptions(source=wrong))
    assert not (tmp_path / "third" / "calibration.json").exists()


def test_a_camera_that_the_calibration_lacks_is_told_and_others_stay_in_it(
    bare: Session, tmp_path: Path
) -> None:
    some = calibration({name: RIG[name] for name in ("a", "b", "d")} | {"gone": make_view((0.5, 0, 0))})
    partly = calibrate(
        copy_of(bare, tmp_path / "fourth"), CalibrateOptions(source=copy_of(bare, tmp_path / "some", some))
    )
    assert (partly.cameras, partly.missing) == (("a", "b", "d"), ("c",))
    there = Session.open(tmp_path / "fourth").calibration()
    assert there is not None
    assert {*there.cameras} == {"a", "b", "d", "gone"}


def test_coverage_is_of_the_recordings_of_the_board(bare: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        calibration_run, "detect_board", lambda recordings, board: [r.name for r in recordings]
    )
    monkeypatch.setattr(
        calibration_run, "count_coverage", lambda dataset, board, corners: (dataset.name, corners)
    )
    assert cover(bare.folder, CalibrateOptions()) == ("boards", ["boards"])


def test_a_running_rig_has_the_views_of_its_newest_session_that_fits(bare: Session, tmp_path: Path) -> None:
    dataset = Dataset(bare)
    modes = camera_modes(dataset)
    assert find_rig_views(modes, None) == ({}, "")
    folder = tmp_path / "sessions"
    assert find_rig_views(modes, folder) == ({}, "")
    for age, (name, known) in enumerate(
        (
            ("without", None),
            ("one", calibration({"a": RIG["a"]})),
            ("newer", calibration({name: RIG[name] for name in "abd"})),
            ("older", calibration(RIG, "arbitrary")),
        )
    ):
        at_s = 1_700_000_000 - 60 * age
        session = copy_of(bare, folder / name, known)
        os.utime(session / "session.json", (at_s, at_s))
    (folder / "broken").mkdir()
    (folder / "broken" / "session.json").write_text("{")
    views, unit = find_rig_views(modes, folder)
    assert (sorted(views), unit) == (["a", "b", "d"], "m")
    assert views["d"].centre == pytest.approx(RIG["d"].centre)
    # A camera in another mode has none, nor has one whose calibration cannot be right.
    other = modes | {"a": msgspec.structs.replace(modes["a"], width=640)}
    assert sorted(find_rig_views(other, folder)[0]) == ["b", "d"]
    kept = calibration(RIG)
    odd = msgspec.structs.replace(kept.cameras["b"], fx=-1.0)
    keep_calibration(dataset, msgspec.structs.replace(kept, cameras=kept.cameras | {"b": odd}))
    assert sorted(find_rig_views(modes, None)[0]) == ["a", "c", "d"]
    assert sorted(find_rig_views(modes, folder)[0]) == ["a", "b", "d"]


def test_a_kept_calibration_fits_half_of_a_rigs_cameras_or_is_not_this_rigs(bare: Session) -> None:
    keep_calibration(Dataset(bare), calibration(RIG))
    modes = camera_modes(Dataset(bare))
    for others, fits in ((4, True), (5, False)):
        larger = modes | {f"other{k}": modes["a"] for k in range(others)}
        assert (find_calibration(larger) is not None) == fits
    pair = {name: modes[name] for name in "ab"}
    assert find_calibration(pair) is not None
    assert find_calibration({"a": modes["a"], "other": modes["a"]}) is None


def test_an_import_adopts_no_calibration_of_a_rig(bare: Session, tmp_path: Path) -> None:
    own = calibration(RIG)
    assert known_calibration(Dataset(bare)) is None
    keep_calibration(Dataset(bare), own)
    known = known_calibration(Dataset(bare))
    assert known is not None
    assert known.cameras == own.cameras
    imported = Session.open(copy_of(bare, tmp_path / "import", origin="imported"))
    assert known_calibration(Dataset(imported)) is None
    assert known_calibration(Dataset.open(copy_of(bare, tmp_path / "own", own, origin="imported"))) == own


def test_what_a_check_found_is_described() -> None:
    none = CalibrationCheck(error_px=None, points=0, errors_px={}, unchecked=("c",), moved=(), holds=True)
    assert describe_check(none) == "it cannot be checked: the cameras share too few static points"
    some = CalibrationCheck(
        error_px=0.24, points=90, errors_px={}, unchecked=("c", "d"), moved=(), holds=True
    )
    assert describe_check(some) == f"{some} (points at rest fit within 0.2 px); not checked: c, d"


def test_marks_a_board_and_the_ground_rescale() -> None:
    assert not CalibrateOptions().rescales
    for options in (
        {"distance": (MARKS, 1.0)},
        {"scale_by_board": True},
        {"ground": Path()},
        {"vertical": MARKS},
    ):
        assert CalibrateOptions(**options).rescales


@pytest.fixture
def judged(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """A candidate of a board or of the images, the quality it has, and what was kept."""
    parts: dict[str, Any] = {"calibration": calibration(RIG), "quality": "good", "kept": [], "board": None}
    parts["errors"] = {"a": "its errors", "z": "of another camera"}

    def refuse(quality: str, cameras: int, advice: str) -> None:
        if quality == "bad":
            raise BadInputError(f"{cameras} cameras, bad{advice}")

    monkeypatch.setattr(
        calibration_run,
        "_candidate",
        lambda scene, options: calibration_run._Candidate(
            calibration=parts["calibration"], shared={}, board=parts["board"], errors=parts["errors"]
        ),
    )
    monkeypatch.setattr(calibration_run, "judge_calibration", lambda views, shared: parts["quality"])
    monkeypatch.setattr(calibration_run, "refuse_bad_calibration", refuse)
    monkeypatch.setattr(calibration_run, "check_rig", lambda *_: parts["check"])
    monkeypatch.setattr(
        calibration_run, "_keep", lambda dataset, calibration: parts["kept"].append(calibration) or True
    )
    sound = CalibrationCheck(error_px=0.1, points=90, errors_px={}, unchecked=(), moved=(), holds=True)
    parts["check"] = sound
    return parts


@pytest.mark.parametrize("source", CalibrationSource)
def test_what_is_found_here_is_judged_by_its_own_points_and_kept(
    bare: Session, tmp_path: Path, judged: dict[str, Any], source: CalibrationSource
) -> None:
    here = source in (CalibrationSource.SFM, CalibrationSource.BOARD, CalibrationSource.CHARUCO)
    own = source is CalibrationSource.SESSION
    session = copy_of(bare, tmp_path / "session")
    result = calibrate(session, CalibrateOptions(source=source))
    assert (result.stored, result.kept) == (not own, here)
    assert (result.check is None) == (source is CalibrationSource.SFM)
    assert cast("Any", result.errors) == {"a": "its errors"}
    assert len(judged["kept"]) == here
    refused = calibrate(session, CalibrateOptions(source=source, force=True, keep=False))
    assert not refused.kept
    assert calibrate(session, CalibrateOptions(source=source, force=True, keep=True)).kept
    judged["quality"] = "bad"
    if here or own:
        with pytest.raises(BadInputError, match=r"^4 cameras, bad$"):
            calibrate(session, CalibrateOptions(source=source, force=True))
    else:
        calibrate(session, CalibrateOptions(source=source, force=True))


def test_a_board_is_believed_before_points_at_rest_but_for_its_lenses(
    bare: Session, tmp_path: Path, judged: dict[str, Any]
) -> None:
    judged["check"] = msgspec.structs.replace(judged["check"], holds=False)
    options = CalibrateOptions(source=CalibrationSource.BOARD, force=True)
    session = copy_of(bare, tmp_path / "session")
    with pytest.raises(BadInputError, match="does not hold for these pictures: no camera has moved"):
        calibrate(session, options)
    judged["board"] = "a board's coverage"
    result = calibrate(session, options)
    assert (result.board, result.check) == ("a board's coverage", None)
    judged["check"] = msgspec.structs.replace(judged["check"], by_lenses="points say 300 px")
    with pytest.raises(BadInputError, match="does not hold for these pictures: points say 300 px"):
        calibrate(session, options)
    # Where faults leave one camera, nothing is judged; where they leave two, the others are named.
    odd = {
        name: msgspec.structs.replace(camera, fx=-1.0) for name, camera in calibration(RIG).cameras.items()
    }
    good = calibration(RIG)
    judged["calibration"] = msgspec.structs.replace(good, cameras=odd | {"a": good.cameras["a"]})
    with pytest.raises(BadInputError, match="has 3 faults"):
        calibrate(session, options)


def test_a_camera_without_a_sound_calibration_is_left_out_and_named(
    bare: Session, tmp_path: Path, judged: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    good = calibration(RIG)
    odd = msgspec.structs.replace(good.cameras["b"], fx=-1.0)
    judged["calibration"] = msgspec.structs.replace(good, cameras=good.cameras | {"b": odd})
    result = calibrate(copy_of(bare, tmp_path / "session"), CalibrateOptions())
    assert (result.cameras, result.missing) == (("a", "c", "d"), ("b",))
    assert "b is left out: the calibration of camera b cannot be right" in capsys.readouterr().err
    stored = Session.open(tmp_path / "session").calibration()
    assert stored is not None
    assert {*stored.cameras} == {"a", "c", "d"}
    rescaled = CalibrateOptions(source=CalibrationSource.SESSION, distance=(MARKS, 1.0), force=True)
    again = calibrate(tmp_path / "session", rescaled)
    assert (again.stored, again.kept, again.unit) == (True, True, "m")
    assert "scale from a distance of 1 m" in again.source


def test_a_kept_calibration_that_is_used_says_from_when_and_how_it_fits(
    bare: Session, capsys: pytest.CaptureFixture[str]
) -> None:
    keep_calibration(Dataset(bare), calibration(RIG))
    given = OpenScene(Dataset(bare)).given
    assert given is not None
    assert given.source.startswith("a board, kept from boards of ")
    said = capsys.readouterr().err
    assert "calibration kept from boards of " in said
    assert "no camera has moved (points at rest fit within " in said
