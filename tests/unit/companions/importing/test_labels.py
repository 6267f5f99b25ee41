"""A camera and a session are called as their owner wrote them, whatever their folders are named."""

import json
import shlex
from pathlib import Path
from unicodedata import normalize

import pytest

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.companions.importing.recording import import_found
from capture_app.session.format.camera_labels import require_camera
from capture_app.session.format.manifest import MANIFEST
from capture_app.session.reading.reader import Session
from tests.unit.companions.importing.numbered_video import imported, write_video
from tests.unit.session.conftest import jpeg

SCRIPTS = {
    "german": ("Böhm", "größer"),
    "spaces": ("left cam", "right cam"),
    "japanese": ("カメラ左", "カメラ右"),
    "half japanese": ("カメラ1", "左1"),
    "arabic": ("كاميرا يمين", "كاميرا يسار"),
    "emoji": ("👩‍🚀 left", "👩‍🚀 right"),
    "reserved": ("CON", "cam."),
    "alike in ASCII": ("Bohm", "Böhm"),
    "long": (f"{'x' * 70} 1", f"{'x' * 70} 2"),
}
FORMS = pytest.mark.parametrize("form", ["NFC", "NFD"])


def cameras_of(session: Session) -> dict[str, str]:
    return session.stored_manifest.labels


def shoot(folder: Path, names: tuple[str, ...], form: str = "NFC") -> Path:
    """Folders of three numbered images, as a system that writes this form of Unicode names them."""
    for name in names:
        place = folder / normalize(form, name)  # type: ignore[arg-type]
        place.mkdir(parents=True)
        for number in range(3):
            (place / f"{number:04d}.jpg").write_bytes(jpeg(number))
    return folder


@FORMS
@pytest.mark.parametrize("names", SCRIPTS.values(), ids=SCRIPTS)
def test_folders_of_any_script_are_cameras_of_these_labels(
    names: tuple[str, ...], form: str, tmp_path: Path
) -> None:
    session, _ = imported(shoot(tmp_path / "shoot", names, form), fps=30.0)
    assert sorted(cameras_of(session).values()) == sorted(names)
    assert all(name.isascii() and len(name) <= 64 for name in cameras_of(session))
    assert len({name.casefold() for name in cameras_of(session)}) == 2
    assert Session.open(session.folder).manifest == session.manifest


@FORMS
@pytest.mark.parametrize("names", SCRIPTS.values(), ids=SCRIPTS)
def test_the_command_takes_labels_everywhere(
    names: tuple[str, ...],
    form: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = shoot(tmp_path / "shoot", names)
    typed = [normalize(form, name) for name in names]  # type: ignore[arg-type]
    for at in (0, 0.1):
        rows = "".join(f"{at + n / 10}\n" for n in range(3))
        (tmp_path / f"{at}.csv").write_text(f"time\n{rows}")
    sources = [f"{say}={folder / name}" for say, name in zip(typed, names, strict=True)]
    tables = [f"--timestamps={say}={tmp_path / str(at)}.csv" for say, at in zip(typed, (0, 0.1), strict=True)]
    shift = f"--time-shift-ms={typed[1]}=-100"
    out = ["--name", "my take", "--out", str(tmp_path / "out")]
    assert run(["sessions", "import", *sources, *tables, shift, *out]) == ExitCode.OK
    shown = capsys.readouterr()
    session = Session.open(tmp_path / "out" / "my-take")
    assert session.manifest.label == "my take"
    assert [len(of) for of in session.images_by_instant()] == [2, 2, 2]
    for name in names:
        assert name in shown.out
        named = require_camera(normalize(form, name), cameras_of(session), "")  # type: ignore[arg-type]
        assert cameras_of(session)[named] == name
    assert shown.out.startswith("my take: imported")
    step = shown.err.splitlines()[-1].removeprefix("next: capture-app ")
    assert run([*shlex.split(step), "--replace", "--width", "32"]) == ExitCode.OK
    assert Path("my-take.jpg").is_file()
    assert run(["sessions", "list", str(tmp_path / "out")]) == ExitCode.OK
    assert "my-take (my take)" in capsys.readouterr().out


@FORMS
def test_a_table_and_a_calibration_name_the_cameras_as_their_owner(form: str, tmp_path: Path) -> None:
    names = ("Böhm", "カメラ左")
    folder = shoot(tmp_path / "shoot", names)
    written = [normalize(form, name) for name in names]  # type: ignore[arg-type]
    rows = [f"{name},{n},{1_700_000_000 + n / 10}" for name in written for n in range(3)]
    (folder / "times.csv").write_text("\n".join(["camera,frame,time", *rows]), encoding="utf-8")
    lens = (
        "size = [16, 12]\nmatrix = [[9, 0, 8], [0, 9, 6], [0, 0, 1]]\ndistortions = [0, 0, 0, 0, 0]\n"
        "rotation = [0, 0, 0]\ntranslation = [{}, 0, 0]\n"
    )
    tables = [f'["{name}"]\n{lens.format(n)}' for n, name in enumerate(written)]
    (folder / "calibration.toml").write_text("\n".join(tables), encoding="utf-8")
    session, said = imported(folder)
    assert session.manifest.burst.common_times is not None
    assert session.manifest.burst.common_times.state == "recorded"
    calibration = session.calibration()
    assert calibration is not None
    assert calibration.cameras["Bohm"].translation == (0, 0, 0)
    assert {*calibration.cameras} == {*cameras_of(session)}
    with pytest.raises(BadInputError, match=r"it has Bohm \(Böhm\), cam1 \(カメラ左\)"):
        session.camera("Böhm")
    assert "cameras of" not in said


@pytest.mark.parametrize("names", [("Left", "left"), ("Größe", "GRÖSSE"), ("Bo\u0308hm", "Böhm")])
def test_labels_that_another_system_takes_for_one_are_refused(names: tuple[str, str], tmp_path: Path) -> None:
    for place in ("a", "b"):
        shoot(tmp_path, (place,))
    sources = [f"{name}={tmp_path / place}" for name, place in zip(names, "ab", strict=True)]
    with pytest.raises(BadInputError, match="two cameras are named"):
        import_found(sources, tmp_path / "out", "s", ImportOptions(fps=30.0))


def test_clips_of_any_script_keep_their_labels(tmp_path: Path) -> None:
    for camera in ("左", "右"):
        for take in ("take1", "take2"):
            write_video(tmp_path / "歩く" / f"{camera}_{take}.mp4", [33_333 * n for n in range(4)])
    sessions = import_found(
        [str(tmp_path / "歩く")], tmp_path / "out", "歩く", ImportOptions(synchronized=True)
    )
    assert [session.manifest.label for session in sessions] == ["歩く-take1", "歩く-take2"]
    assert len({session.folder for session in sessions}) == 2
    for session in sessions:
        assert sorted(cameras_of(session).values()) == ["右", "左"]


def test_a_name_that_is_its_folders_has_no_label(tmp_path: Path) -> None:
    session, _ = imported(shoot(tmp_path / "shoot", ("left", "right")), fps=30.0)
    text = (session.folder / MANIFEST).read_text()
    assert "label" not in json.loads(text)
    assert all("label" not in camera["facts"] for camera in json.loads(text)["cameras"])


def test_a_session_that_exists_is_refused_before_anything_is_aligned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = shoot(tmp_path / "shoot", ("left", "right"))
    import_found([str(folder)], tmp_path / "out", "s", ImportOptions(fps=30.0))
    monkeypatch.setattr("capture_app.companions.importing.recording.make_times", None)
    with pytest.raises(BadInputError, match="exists already"):
        import_found([str(folder)], tmp_path / "out", "s", ImportOptions(fps=30.0))


@pytest.mark.parametrize("name", ["", " ", "a/b", "a\\b", "a\nb", ".."])
def test_a_session_name_that_is_none_is_refused(name: str, tmp_path: Path) -> None:
    folder = shoot(tmp_path / "shoot", ("left", "right"))
    if name == "..":
        (session,) = import_found([str(folder)], tmp_path / "out", name, ImportOptions(fps=30.0))
        assert session.folder.parent == tmp_path / "out"
        return
    with pytest.raises(BadInputError, match="is not a valid name for a session"):
        import_found([str(folder)], tmp_path / "out", name, ImportOptions(fps=30.0))


def test_a_name_of_no_text_is_a_label_that_can_be_stored(tmp_path: Path) -> None:
    """Names of files need not be UTF-8."""
    session, _ = imported(shoot(tmp_path / "shoot", ("a\udcff", "b")), fps=30.0)
    assert sorted(cameras_of(session).values()) == ["a?", "b"]


def test_a_renamed_session_is_called_by_its_new_name(tmp_path: Path) -> None:
    folder = shoot(tmp_path / "shoot", ("left", "right"))
    import_found([str(folder)], tmp_path, "my take", ImportOptions(fps=30.0))
    assert run(["sessions", "rename", str(tmp_path / "my-take"), "other"]) == ExitCode.OK
    assert not Session.open(tmp_path / "other").manifest.label


def test_an_export_brings_the_labels_back(tmp_path: Path) -> None:
    session, _ = imported(shoot(tmp_path / "shoot", SCRIPTS["japanese"]), fps=30.0)
    assert (
        run(["sessions", "export", str(session.folder), "--to", "colmap", "--out", str(tmp_path / "x")]) == 0
    )
    (back,) = import_found([str(tmp_path / "x")], tmp_path, "back", ImportOptions())
    assert cameras_of(back) == cameras_of(session) == {"cam0": "カメラ右", "cam1": "カメラ左"}
