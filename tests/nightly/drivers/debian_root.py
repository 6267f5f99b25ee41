"""A Debian 13 with libcamera, and this program's requirements for its Python, kept in the cache."""

import hashlib
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

from tests.project import ROOT

SUITE, PYTHON = "trixie", "3.13"
PACKAGES = "python3 python3-venv python3-libcamera libcamera-ipa udev"
ENVIRONMENT = "opt/simulshot"
"""A virtual environment that does not see the system's packages, as an installed program has."""
_APT_SETTINGS = Path("/etc/apt/apt.conf.d")


class NoRootError(Exception):
    """Why there is no such Debian here."""


def debian_root() -> Path:
    """Its root folder. Raises NoRootError where it cannot be made: without root, mmdebstrap or a network."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    requirements, entry_points = project["dependencies"], _entry_points(project["entry-points"])
    constraints = ROOT / "constraints.txt"
    made_of = "\n".join([SUITE, PACKAGES, *requirements, entry_points, constraints.read_text()])
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "simulshot-tests"
    root = cache / f"libcamera-{hashlib.sha256(made_of.encode()).hexdigest()[:16]}"
    if root.is_dir():
        return root
    if os.geteuid() != 0:
        raise NoRootError("only root can make a Debian 13 with libcamera (mmdebstrap)")
    if shutil.which("mmdebstrap") is None:
        _run("apt-get", "install", "-y", "-qq", "--no-install-recommends", "mmdebstrap")
    cache.mkdir(parents=True, exist_ok=True)
    made = cache / "being-made"
    shutil.rmtree(made, ignore_errors=True)
    # How packages are reached is this machine's own: a mirror of its own, a proxy, a snapshot.
    options = [f"--aptopt={file}" for file in sorted(_APT_SETTINGS.glob("99*"))]
    include = f"--include={','.join(PACKAGES.split())}"
    _run("mmdebstrap", "--quiet", "--variant=minbase", include, *options, SUITE, str(made))
    _run("chroot", str(made), "python3", "-m", "venv", "--without-pip", f"/{ENVIRONMENT}")
    site = made / ENVIRONMENT / "lib" / f"python{PYTHON}" / "site-packages"
    chosen = (
        "--only-binary=:all:",
        "--python-version",
        PYTHON,
        "--target",
        str(site),
        "-c",
        str(constraints),
    )
    _run(sys.executable, "-m", "pip", "install", "--quiet", *chosen, *requirements)
    # The code itself is the repository's; only its plugins are found by what an installer leaves.
    metadata = site / f"{project['name']}-0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 0\n")
    (metadata / "entry_points.txt").write_text(entry_points)
    made.rename(root)
    return root


def _entry_points(groups: dict[str, dict[str, str]]) -> str:
    lines = [[f"[{group}]", *map(" = ".join, entries.items())] for group, entries in groups.items()]
    return "\n".join(line for group in lines for line in group)


def _run(*command: str) -> None:
    done = subprocess.run(
        command,
        env={**os.environ, "DEBIAN_FRONTEND": "noninteractive"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise NoRootError(f"{command[0]} failed: {last}")
