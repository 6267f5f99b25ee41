"""The documentation as a site: built strictly, with all pages, the commands and the names of Python."""

import subprocess
import sys

from tests.project import ROOT


def test_the_site_is_built_strictly() -> None:
    done = subprocess.run(
        [sys.executable, "docs/site.py"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    site = ROOT / "build" / "site"
    for page in (ROOT / "docs").glob("*.md"):
        assert (site / "docs" / page.stem / "index.html").is_file()
    commands = (site / "docs/commands/index.html").read_text()
    assert "--until-unused" not in commands, "it is hidden"
    for name in ("capture-app burst", "sessions import", "--tolerance-us", "reconstruct tolerance"):
        assert name in commands
    reference = (site / "docs/python-reference/index.html").read_text()
    for name in ("open_session", "hard_bound_ns", "MadeStereo", "wait_until_ready"):
        assert name in reference
