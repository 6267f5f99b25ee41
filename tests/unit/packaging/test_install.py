"""What installs the commands, with stand-ins for what it drives; bare machines try it by hand."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.project import ROOT

UV = """#!/bin/sh
echo "uv $*" >>"$LOG"
case "$*" in "tool dir --bin") echo "$LINKS" ;; esac
"""
PIPX = """#!/bin/sh
echo "pipx $*" >>"$LOG"
"""
COMMAND = """#!/bin/sh
case "$_CAPTURE_APP_COMPLETE$_RECONSTRUCT_COMPLETE" in ?*) echo "# completes $0" ;; *) echo version 1 ;; esac
"""


@pytest.fixture
def user(tmp_path: Path) -> dict[str, str]:
    """A user who is not root, whose commands come up in ~/.local/bin, with folders of their own."""
    programs, links = tmp_path / "bin", tmp_path / "home" / ".local" / "bin"
    links.mkdir(parents=True)
    programs.mkdir()
    scripts = {programs / "id": "#!/bin/sh\necho 1000\n"}
    scripts |= {links / name: COMMAND for name in ("capture-app", "reconstruct")}
    for path, text in scripts.items():
        path.write_text(text)
        path.chmod(0o755)
    home = str(tmp_path / "home")
    kept = {name: value for name, value in os.environ.items() if not name.startswith("XDG_")}
    found = {"HOME": home, "LINKS": str(links), "LOG": str(tmp_path / "log")}
    return {**kept, **found, "PATH": f"{programs}{os.pathsep}/usr/local/bin:/usr/bin:/bin"}


def install(user: dict[str, str], *arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        ["sh", str(ROOT / "install.sh"), *arguments], env=user, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(("program", "text"), [("uv", UV), ("pipx", PIPX)])
@pytest.mark.parametrize(
    ("arguments", "extras"),
    [
        ((), "[reconstruction,people]"),
        (("--capture-only",), ""),
        (("--with", "export,plots"), "[reconstruction,people,export,plots]"),
        (("--capture-only", "--with", "export"), "[export]"),
    ],
)
def test_a_users_own_installer_is_asked(
    user: dict[str, str], program: str, text: str, arguments: tuple[str, ...], extras: str
) -> None:
    script = Path(user["PATH"].partition(os.pathsep)[0]) / program
    script.write_text(text)
    script.chmod(0o755)
    done = install(user, *arguments)
    assert done.returncode == 0, done.stderr
    asked = Path(user["LOG"]).read_text().splitlines()[0]
    assert asked.startswith(f"{program} {'tool ' if program == 'uv' else ''}install --force")
    assert asked.endswith(f"simulshot{extras} @ {ROOT.as_uri()}")
    assert "constraints.txt" in asked
    assert f'export PATH="{user["LINKS"]}:$PATH"' in done.stderr, "it says that they are not on the PATH"
    completions = Path(user["HOME"]) / ".local/share/bash-completion/completions"
    assert sorted(path.name for path in completions.iterdir()) == ["capture-app", "reconstruct"]
    assert "completes" in (completions / "reconstruct").read_text()


def test_removal_leaves_what_is_not_its_own(user: dict[str, str]) -> None:
    links, home = Path(user["LINKS"]), Path(user["HOME"]) / ".local/share/simulshot"
    (home / "program").mkdir(parents=True)
    (home / "spool").mkdir()
    (links / "capture-app").unlink()
    (links / "capture-app").symlink_to(home / "program" / "bin" / "capture-app")
    assert install(user, "--remove").returncode == 0
    assert sorted(path.name for path in links.iterdir()) == ["reconstruct"], "somebody else's program"
    assert sorted(path.name for path in home.iterdir()) == ["spool"]


def test_a_wrong_option_shows_the_right_ones(user: dict[str, str]) -> None:
    done = install(user, "--everything")
    assert done.returncode == 2
    assert "./install.sh --capture-only" in done.stderr


@pytest.mark.parametrize("answer", ["", "y"])
def test_removal_names_what_would_go_on_and_ends_it_where_that_is_wanted(
    user: dict[str, str], answer: str
) -> None:
    home = Path(user["HOME"])
    unit = home / ".config/systemd/user/simulshot-cam0.service"
    rigs, keys = home / ".local/state/simulshot/rigs", home / ".local/share/simulshot/trust"
    for folder in (unit.parent, rigs, keys):
        folder.mkdir(parents=True)
    unit.write_text("[Unit]")
    systemctl = Path(user["PATH"].partition(os.pathsep)[0]) / "systemctl"
    systemctl.write_text('#!/bin/sh\necho "systemctl $*" >>"$LOG"\n')
    systemctl.chmod(0o755)
    rig = subprocess.Popen(["sh", "-c", "sleep 600; : capture_app.cli"])
    try:
        for pid in (rig.pid, 1):
            (rigs / f"{pid}.json").write_text("{}")
        done = install(user | {"STOP": answer}, "--remove")
        assert done.returncode == 0, done.stderr
        assert str(unit) in done.stderr
        assert f"rigs that run in the background, by their processes: {rig.pid}\n" in done.stderr
        assert f"rm -r '{keys}'" in done.stderr
        assert unit.exists() is not bool(answer)
        if answer:
            assert rig.wait(60) == -15
            asked = Path(user["LOG"]).read_text()
            assert "systemctl --user disable --now simulshot-cam0.service" in asked
        else:
            assert rig.poll() is None
            assert "STOP=y ./install.sh --remove ends them" in done.stderr
    finally:
        rig.kill()
        rig.wait()
    assert keys.is_dir(), "keys stay"
