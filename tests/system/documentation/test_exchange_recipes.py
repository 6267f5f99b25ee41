"""The exporter and importer of docs/plugins.md, as written there, as a package outside the project."""

import json
import shutil
from pathlib import Path

from capture_app.common.errors import ExitCode
from capture_app.session.format.export_record import RECORD
from capture_app.session.reading.reader import Session
from tests.unit.documentation.test_exchange_recipes import (
    package,  # noqa: F401 - a fixture
    run,
)
from tests.unit.plugins.programs.conftest import Make, make  # noqa: F401 - a fixture


def test_a_package_outside_adds_a_format_and_an_importer(make: Make, package: Path, tmp_path: Path) -> None:
    session, out = make(), tmp_path / "out"
    (done,) = run(package, ("export", str(session.folder), "--to", "image-index", "--out", str(out)))
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{out}\n", "")
    index = json.loads((out / "index.json").read_text())
    assert len(index) == len(session.manifest.images)
    foreign, wrong = (Path(shutil.copytree(out, tmp_path / name)) for name in ("foreign", "wrong"))
    (foreign / RECORD).unlink()  # another program does not write it
    (wrong / RECORD).unlink()
    (wrong / "index.json").write_text("[3]")
    recorded, done, bad = run(
        package,
        ("import", str(out), "--name", "again", "--out", str(tmp_path), "--json"),
        ("import", str(foreign), "--name", "index", "--out", str(tmp_path), "--json"),
        ("import", str(wrong), "--name", "bad", "--out", str(tmp_path)),
    )
    assert recorded.returncode == 0, recorded.stderr
    assert Session.open(tmp_path / "again").manifest.burst == session.manifest.burst, "by its record"
    assert done.returncode == 0, done.stderr
    assert f"{foreign} is of Image index" in done.stderr
    images = Session.open(tmp_path / "index").manifest.images
    assert {(one.camera, one.leader_ns, one.sha256) for one in images} == {
        (one.camera, one.leader_ns, one.sha256) for one in session.manifest.images
    }
    assert bad.returncode == ExitCode.BAD_INPUT
    assert "is not an image index" in bad.stderr
