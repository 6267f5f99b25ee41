"""`capture-app sessions export`: bad sessions and bad places give one clear line and leave nothing."""

import hashlib
import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.session.exporting.exporter import Exporter, Option, load_exporters, own_options
from capture_app.session.format.manifest import JOURNAL, MANIFEST, image_path
from tests.project import ROOT
from tests.unit.plugins.programs.conftest import Make
from tests.unit.session.conftest import edit_manifest

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def refuses(tmp_path: Path, capsys: Capture) -> Callable[..., None]:
    """Export to tmp_path/out, which must fail with one line on stderr and leave no trace."""

    def check(session: Path, code: ExitCode, reason: str, name: str = "colmap") -> None:
        out = tmp_path / "deep" / "out"
        assert run(["sessions", "export", str(session), "--to", name, "--out", str(out)]) == code
        stdout, stderr = capsys.readouterr()
        assert stdout == ""
        *warnings, error = stderr.splitlines()
        assert not warnings or name == "splats", "it warns of what a trainer cannot use before it writes"
        assert reason in error
        assert not out.exists()
        assert not out.parent.exists() or list(out.parent.iterdir()) == []

    return check


def test_paths_on_stdout_talk_on_stderr(make: Make, tmp_path: Path, capsys: Capture) -> None:
    session, out = make(), tmp_path / "out"
    out.mkdir()  # an empty folder may be there
    arguments = ["sessions", "export", str(session.folder), "--to", "colmap", "--out"]
    assert run([*arguments, str(out)]) == 0
    stdout, stderr = capsys.readouterr()
    assert stdout.strip() == str(out)
    assert "left out" in stderr
    assert out.stat().st_mode & 0o777 == 0o750, "for its owner and group, as what is recorded"
    assert run([*arguments, str(tmp_path / "second"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["format"], report["images"]) == ("colmap", 11)
    assert not list(tmp_path.glob(".*"))


def test_bad_places(make: Make, tmp_path: Path, capsys: Capture) -> None:
    folder = make().folder
    full, file = tmp_path / "full", tmp_path / "file"
    full.mkdir()
    (full / "precious").write_text("mine")
    file.write_text("mine")
    (tmp_path / "link").symlink_to(full)
    for out, reason in (
        (full, "has something in it"),
        (file, "is a file"),
        (tmp_path / "link", "has something in it"),
        (folder / "exports", "inside the session"),
        (file / "below", "cannot write"),
    ):
        code = run(["sessions", "export", str(folder), "--to", "colmap", "--out", str(out)])
        assert code in (ExitCode.BAD_INPUT, ExitCode.FAILURE)
        error = capsys.readouterr().err
        assert reason in error
        assert len(error.splitlines()) == 1
    assert [path.name for path in full.iterdir()] == ["precious"]
    assert not (folder / "exports").exists()


def test_an_unknown_format(make: Make, tmp_path: Path, capsys: Capture) -> None:
    out = str(tmp_path / "out")
    assert run(["sessions", "export", str(make().folder), "--to", "betamax", "--out", out]) == ExitCode.USAGE
    assert "betamax" in capsys.readouterr().err


@pytest.mark.parametrize("asked", ["3dgs", "Blender", "gltf"])
def test_another_word_for_a_format_is_answered_with_its_name(
    asked: str, make: Make, tmp_path: Path, capsys: Capture
) -> None:
    assert run(["sessions", "export", str(make().folder), "--to", asked, "--out", str(tmp_path / "x")]) == 2
    assert f"'{asked}' is not a format: --to splats is for it" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["nerfstudio", "n3dv", "pose2sim"])
def test_without_a_calibration(make: Make, refuses: Callable[..., None], name: str) -> None:
    refuses(make(calibrate=()).folder, ExitCode.BAD_INPUT, "has no calibration, which", name)


def test_calibrations_that_cannot_be(make: Make, refuses: Callable[..., None]) -> None:
    partial = make(calibrate=("left", "mid"))
    refuses(partial.folder, ExitCode.BAD_INPUT, "right is not calibrated", "nerfstudio")
    path = partial.folder / "calibration.json"
    content = json.loads(path.read_text())
    content["cameras"]["right"] = dict(content["cameras"]["left"], width=97)
    path.write_text(json.dumps(content))
    refuses(partial.folder, ExitCode.BAD_INPUT, "97x64", "colmap")
    content["cameras"]["right"] = dict(content["cameras"]["left"], rotation=[[1, 0, 0], [0, 1, 0], [0, 1, 1]])
    path.write_text(json.dumps(content))
    refuses(partial.folder, ExitCode.BAD_INPUT, "its rotation matrix is not orthonormal", "mcap")


def test_what_does_not_decode(make: Make, refuses: Callable[..., None]) -> None:
    session = make()
    writer_bytes = b"not a picture at all"

    def claim(content: dict[str, Any]) -> None:
        image = content["images"][0]
        image["bytes"] = len(writer_bytes)
        image["sha256"] = hashlib.sha256(writer_bytes).hexdigest()
        (session.folder / image["path"]).write_bytes(writer_bytes)

    edit_manifest(session, claim)
    for name in ("colmap", "mp4", "mcap"):
        refuses(session.folder, ExitCode.BAD_INPUT, "not an image that can be decoded", name)


def go_back(content: dict[str, Any]) -> None:
    images = [image for image in content["images"] if image["camera"] == "left"]
    images[2]["leader_ns"] = images[1]["leader_ns"] - 1


CONTRADICTIONS: list[tuple[Callable[[dict[str, Any]], object], str]] = [
    (lambda content: content["images"].append(content["images"][0]), "twice"),
    (lambda content: content["images"][1].update(path=content["images"][0]["path"]), "twice"),
    (go_back, "go backwards"),
    (lambda content: content["burst"]["instants_ns"].reverse(), "is not after"),
    (lambda content: content.update(schema_version=99), "newer simulshot"),
    (lambda content: content["images"][0].update(path="../../etc/passwd"), "outside the session"),
    (lambda content: content.update(images=[]), "no images"),
]


@pytest.mark.parametrize(("change", "reason"), CONTRADICTIONS)
def test_manifests_that_contradict_themselves(
    make: Make, refuses: Callable[..., None], change: Callable[[dict[str, Any]], object], reason: str
) -> None:
    session = make()
    edit_manifest(session, change)
    refuses(session.folder, ExitCode.BAD_INPUT, reason)


def test_an_image_that_is_a_link_out(make: Make, refuses: Callable[..., None], tmp_path: Path) -> None:
    session = make()
    file = session.folder / image_path("left", 0)
    outside = tmp_path / "secret.jpg"
    shutil.move(file, outside)
    file.symlink_to(outside)
    refuses(session.folder, ExitCode.BAD_INPUT, "outside the session")


def test_an_unfinished_session(make: Make, refuses: Callable[..., None]) -> None:
    session = make()
    (session.folder / MANIFEST).unlink()
    assert (session.folder / JOURNAL).is_file()
    refuses(session.folder, ExitCode.INCOMPLETE, "is incomplete")


@pytest.mark.parametrize(
    ("name", "package", "advised"),
    [
        ("mp4", "av", "av"),
        ("n3dv", "av", "av"),
        ("mcap", "mcap", "mcap"),
        ("mcap", "mcap_protobuf", "mcap-protobuf-support"),
        ("rrd", "rerun", "rerun-sdk"),
    ],
)
def test_a_package_that_is_not_there(
    make: Make,
    refuses: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    package: str,
    advised: str,
) -> None:
    for module in [one for one in sys.modules if one == package or one.startswith(f"{package}.")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, package, None)
    refuses(make().folder, ExitCode.NOT_AVAILABLE, f"'{advised}>=", name)


def test_a_full_disk_leaves_nothing(
    make: Make, refuses: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    from capture_app.companions.exporting import export_session

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", "rig_config.json")

    monkeypatch.setattr(export_session, "write_frames", full)
    refuses(make().folder, ExitCode.FAILURE, "is full")


def test_the_table_of_formats_says_what_each_needs() -> None:
    page = ROOT / "docs" / "exports.md"
    rows = [line.split("|")[1:-1] for line in page.read_text().splitlines() if line.startswith("| `")]
    rows = [row for row in rows if len(row) == 5]
    calibrations = {row[0].strip(" `"): row[3].strip() for row in rows if " " not in row[0].strip()}
    words = {"unused": "", "required": "yes"}
    for name, exporter in load_exporters().items():
        word = words.get(exporter.calibration, "for ")
        assert calibrations[name].startswith(word), name
        assert word or not calibrations[name], name


def test_the_parameters_of_a_writer_are_options_of_its_format() -> None:
    def write(burst: Any, folder: Path, *, near: Annotated[float | None, Option("z", "M")] = None) -> None:
        raise NotImplementedError

    own = own_options(Exporter(write=write, help="", program="", one_instant=True))
    assert {name: kind for name, (kind, _) in own.items()} == {"instant": int, "near": float}
    assert own["near"][1].metavar == "M"

    def plain(burst: "Unknown", folder: Path) -> None:  # type: ignore[name-defined] # noqa: F821
        raise NotImplementedError

    assert own_options(Exporter(write=plain, help="", program="")) == {}
