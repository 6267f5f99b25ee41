"""A Windows Python on this machine, under Wine, and a copy of this checkout that only it uses."""

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.conftest import SHARED
from tests.project import ROOT

KIT = SHARED / "windows"
CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "simulshot-windows"
SITE_PACKAGES = CACHE / "kit" / "py" / "Lib" / "site-packages"
CHECKOUT, DATA = "Z:\\checkout", "Z:\\data"
"""The checkout and the folder for results, as Windows names them."""


@dataclass(frozen=True)
class WindowsPython:
    """The programs of a checkout under Windows."""

    checkout: Path
    data: Path

    def start(self, *command: str, variables: Mapping[str, str] | None = None) -> "WindowsProcess":
        """Start a program: capture-app, reconstruct, simulshot or python, with its arguments."""
        given = " ".join(f"{name}={value}" for name, value in (variables or {}).items())
        environment = {**os.environ, "DATA": str(self.data), "WINDOWS_ENV": given}
        # In this network: Wine's server, which all programs share, has the sockets. And to a file: Wine hands
        # a pipe on to what the program leaves behind.
        log = self.data / f"{len(list(self.data.glob('*.log'))):03d}.log"
        with log.open("wb") as output:
            process = subprocess.Popen(
                [str(KIT / "run.sh"), "-m", str(self.checkout), *command],
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=environment,
            )
        return WindowsProcess(process, log)

    def run(self, *command: str, timeout_s: float = 300, variables: Mapping[str, str] | None = None) -> str:
        """Run a program to its end, and return what it says; it must succeed."""
        return self.start(*command, variables=variables).end(timeout_s)


@dataclass(frozen=True)
class WindowsProcess:
    """A program that runs under Windows, whose output is in a file."""

    process: "subprocess.Popen[bytes]"
    log: Path

    @property
    def said(self) -> str:
        """What it has printed until now."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    def end(self, timeout_s: float = 60) -> str:
        """Wait for its end, which must be a success, and return what it has said."""
        try:
            # Its input is open while it runs, and ends with it.
            self.process.communicate(b"\n", timeout_s)
        finally:
            self.stop()
        assert self.process.returncode == 0, self.said[-4000:]
        return self.said

    def stop(self) -> None:
        """End it, if it still runs."""
        self.process.kill()
        self.process.wait()
        if self.process.stdin is not None:
            self.process.stdin.close()


def make_windows_python(folder: Path) -> WindowsPython:
    """Assemble the Windows Python (minutes, once a machine), and copy what git knows of this checkout."""
    if not KIT.is_dir() or os.geteuid() != 0:
        pytest.skip(f"no {KIT}, or not root: it assembles a Windows Python under Wine")
    _note_same_requirements()
    subprocess.run([KIT / "make.sh", ROOT], check=True, env={**os.environ, "PYTHON": sys.executable})
    if not (SITE_PACKAGES / "jsonschema").is_dir():
        options = ("--platform", "win_amd64", "--python-version", "3.11", "--only-binary=:all:")
        target = ("--target", str(SITE_PACKAGES), "--upgrade")
        subprocess.run(
            [sys.executable, "-m", "pip", "install", "-q", *options, *target, "jsonschema"], check=True
        )
    weights = Path(sys.prefix, "share", "simulshot")
    if weights.is_dir():
        shutil.copytree(weights, CACHE / "kit" / "py" / "share" / "simulshot", dirs_exist_ok=True)
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    checkout, data = folder / "checkout", folder / "data"
    data.mkdir()
    for name in listed.split("\0"):
        if name and (ROOT / name).is_file():
            (checkout / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, checkout / name)
    subprocess.run([KIT / "kernels.sh", checkout], check=True)
    return WindowsPython(checkout, data)


def _note_same_requirements() -> None:
    """Keep the packages of an earlier run if they are what is required: a new clone's files look newer."""
    installed, made = CACHE / "kit" / "requirements.txt", CACHE / "kit" / "deps.made"
    if made.exists():
        command = (sys.executable, KIT / "requirements.py", ROOT / "pyproject.toml", CACHE / "kit" / "dist")
        required = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        if required == installed.read_text():
            made.touch()
