"""`capture-app sessions`: data on stdout, one line of error on stderr, the right exit code."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.session.format.journal import TIMES
from capture_app.session.format.manifest import MANIFEST, session_schema_text
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.conftest import edit_manifest

Capture = pytest.CaptureFixture[str]


def fails(capsys: Capture, code: ExitCode, reason: str, *arguments: str) -> str:
    """Run a command that must fail with one line on stderr; its stdout."""
    assert run(["sessions", *arguments]) == code
    out, err = capsys.readouterr()
    assert len(err.splitlines()) == 1
    assert reason in err
    return out


def test_list(session: Session, tmp_path: Path, capsys: Capture) -> None:
    SessionWriter.create(tmp_path, "unfinished").abort()
    assert run(["sessions", "list", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "small" in out
    assert "unusable" in out
    assert run(["sessions", "list", str(tmp_path), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert {one["name"]: one["images"] for one in content["sessions"]} == {"small": 5, "unfinished": 0}
    fails(capsys, ExitCode.BAD_INPUT, "no folder", "list", str(tmp_path / "nowhere"))


def test_without_a_folder_of_sessions_the_list_is_empty(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["sessions", "list", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["sessions"] == []


def test_show(session: Session, capsys: Capture) -> None:
    assert run(["sessions", "show", str(session.folder)]) == 0
    out = capsys.readouterr().out
    for words in ("3 instants", "2 cameras", "5 images, 1 missing", "13 µs apart", "the node left", "250 µs"):
        assert words in out
    # The truth of one camera alone does not say how far apart the two are.
    assert "ground truth" not in out
    assert run(["sessions", "show", str(session.folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["manifest"]["name"] == "small"


def test_show_says_how_far_apart_the_images_are_in_truth(session: Session, capsys: Capture) -> None:
    path = session.folder / TIMES
    truth = json.loads(path.read_text())
    left = truth["images"][0]
    truth["images"].append({**left, "camera": "right", "true_ns": left["true_ns"] + 5_000})
    path.write_text(json.dumps(truth))
    assert run(["sessions", "show", str(session.folder)]) == 0
    assert (
        "by the ground truth they are 5.0 µs apart at the median, 5.0 µs at most" in capsys.readouterr().out
    )


def test_show_leaves_out_the_truth_of_a_camera_that_the_session_lacks(
    session: Session, capsys: Capture
) -> None:
    path = session.folder / TIMES
    truth = json.loads(path.read_text())
    left = truth["images"][0]
    truth["images"] += [{**left, "camera": name, "true_ns": left["true_ns"]} for name in ("right", "gone")]
    path.write_text(json.dumps(truth))
    assert run(["sessions", "show", str(session.folder)]) == 0
    assert "by the ground truth they are 0 ns apart" in capsys.readouterr().out


def test_show_says_whose_stamps_nobody_has_measured(session: Session, capsys: Capture) -> None:
    stamp = {"bias_ns": 21_000_000, "uncertainty_ns": 20_000, "source": "assumed"}
    edit_manifest(session, lambda manifest: manifest["cameras"][0]["facts"].update(stamp=stamp))
    assert run(["sessions", "show", str(session.folder)]) == 0
    out = capsys.readouterr().out
    assert "stamp error of left not measured (±20 µs)" in out
    assert "left stamps its frames 21 ms ±20 µs late, assumed" in out


def test_verify(session: Session, tmp_path: Path, capsys: Capture) -> None:
    good = str(session.folder)
    assert run(["sessions", "verify", good]) == 0
    assert "all 5 images" in capsys.readouterr().out
    image = session.image_file(session.manifest.images[0])
    data = image.read_bytes()
    image.unlink()
    out = fails(capsys, ExitCode.INCOMPLETE, "the image is missing", "verify", good)
    assert "000000.jpg" in out
    image.write_bytes(data + b"x")
    out = fails(capsys, ExitCode.BAD_INPUT, "bytes long", "verify", good, "--json")
    content = json.loads(out)
    assert content["ok"] is False
    assert content["sessions"][0]["problems"][0]["kind"] == "changed"
    (session.folder / MANIFEST).write_text('{"name": 1}')
    fails(capsys, ExitCode.BAD_INPUT, "$.name", "verify", good)
    fails(capsys, ExitCode.BAD_INPUT, "no session at", "verify", str(tmp_path / "nowhere"))
    SessionWriter.create(tmp_path, "unfinished").abort()
    fails(capsys, ExitCode.INCOMPLETE, "incomplete", "verify", str(tmp_path / "unfinished"))


def test_schema(capsys: Capture) -> None:
    assert run(["sessions", "schema"]) == 0
    assert capsys.readouterr().out == session_schema_text()


def test_import(make_images: Callable[..., Path], tmp_path: Path, capsys: Capture) -> None:
    left = make_images("left", ["0.png", "1.png", "2.png"])
    right = make_images("right", ["0.png", "1.png"])
    out = str(tmp_path / "out")
    assert run(["sessions", "import", str(left.parent), "--fps", "50", "--out", out, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content == {
        "session": str(tmp_path / "out" / "recording"),
        "cameras": ["left", "right"],
        "instants": 3,
        "images": 5,
        "missing": 1,
        "calibrated": False,
    }
    named = ["import", f"a={left}", f"b={right}", "--fps", "50", "--out", out]
    assert run(["sessions", *named, "--name", "named", "--count", "2"]) == 0
    assert "not calibrated" in capsys.readouterr().out
    fails(capsys, ExitCode.BAD_INPUT, "exists already", *named, "--name", "named")
    fails(capsys, ExitCode.BAD_INPUT, "--fps", "import", str(left.parent), "--out", out, "--name", "other")
    fails(capsys, ExitCode.USAGE, "'nearest' is not one of", *named, "--fit", "nearest")
    fails(capsys, ExitCode.BAD_INPUT, "'../x' is not a valid name", *named, "--name", "../x")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"recording", "named"}
