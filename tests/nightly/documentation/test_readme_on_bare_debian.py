"""README's commands, in order and as typed, on a Debian that has git, make and python3."""

import os
import re
import shlex
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.project import ROOT

PACKAGES = "ca-certificates,git,make,python3,procps"
MOUNTS = ("proc", "sys", "dev", "dev/pts", "dev/shm")
AS_README_SAYS = (
    ("Try 5", "s"),
    ("5 of 5 ready", "2"),
    (r"Live · 5 pictures within", "Space"),
    (r"(excellent|good|fair) +[0-9.]+ .s", "q"),
    (r"Quit\?", "s"),
)
"""What the screen shows, and the key that is pressed then; the last one stops the rig."""
OPENED = (("Try 5", "q"),)
"""The same where README says no more than that the screen opens."""
PATIENCE_S = 1800.0
NETWORK = re.compile(
    r"PIP_.*|SSL_CERT_.*|REQUESTS_CA_BUNDLE|CURL_CA_BUNDLE|UV_.*|https?_proxy|no_proxy", re.I
)
"""How this machine reaches packages."""


def readme_blocks() -> list[str]:
    """Return README's indented blocks of commands but those that say why they are not run."""
    text = re.sub(r"```.*?```", "", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    found = re.findall(r"(<!-- not run: .+? -->\n)?((?:\n    [^\n]+)+\n)", text)
    return [re.sub(r"(?m)^    ", "", block).strip() for not_run, block in found if not not_run]


@pytest.fixture(params=["bookworm", "trixie"])
def debian(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Path]:
    """The root of a bare Debian with a clone of this repository in /project."""
    if os.geteuid() != 0 or shutil.which("mmdebstrap") is None:
        pytest.skip("only root can make a bare Debian, with mmdebstrap")
    root = tmp_path / "root"
    settings = sorted(Path("/etc/apt/apt.conf.d").glob("99*"))
    options = [
        "--quiet",
        "--variant=minbase",
        f"--include={PACKAGES}",
        *(f"--aptopt={file}" for file in settings),
    ]
    subprocess.run(["mmdebstrap", *options, request.param, str(root)], check=True)
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(root / "project")], check=True)
    for file in (Path("/etc/resolv.conf"), Path("/etc/hosts"), Path("/etc/pip.conf"), *settings):
        if file.exists():
            shutil.copy(file, root / file.relative_to("/"))
    # Whatever a certificate of this machine points to; those that both have are equal.
    subprocess.run(["cp", "-rL", "/etc/ssl/certs/.", str(root / "etc/ssl/certs")], check=False)
    for mount in MOUNTS:
        subprocess.run(["mount", "--bind", f"/{mount}", str(root / mount)], check=True)
    yield root
    for mount in reversed(MOUNTS):
        subprocess.run(["umount", "--lazy", str(root / mount)], check=True)


@pytest.mark.timeout(4 * PATIENCE_S)
def test_every_block_runs_as_it_is_typed(debian: Path) -> None:
    blocks = readme_blocks()
    assert [block.split()[:2] for block in blocks[:2]] == [["make", "demo"], ["make", "test"]]
    for block in blocks:
        code, printed = typed(debian, block)
        assert code == 0, f"{block}\n---\n{printed}"
        assert "Traceback" not in printed, block
    assert (debian / "project/demo/compare/report.html").is_file()


def typed(root: Path, block: str) -> tuple[int, str]:
    """Run a block in a terminal of that system, with its screen's keys. Return exit code and output."""
    kept = [f"{name}={value}" for name, value in os.environ.items() if NETWORK.fullmatch(name)]
    places = [
        "HOME=/root",
        "PATH=/usr/local/bin:/usr/bin:/usr/sbin:/bin:/sbin",
        "LANG=C.UTF-8",
        "TERM=tmux-256color",
    ]
    inside = ["chroot", str(root), "env", "-i", *places, *kept, "bash", "-euc", f"cd /project\n{block}"]
    # A server of its own for each block: that of the block before may still be ending.
    code, tmux = root / "exit-code", ["tmux", "-L", f"readme-{time.monotonic_ns()}"]
    code.unlink(missing_ok=True)
    window = ["-f", "/dev/null", "new-session", "-d", "-x", "120", "-y", "40"]
    subprocess.run([*tmux, *window, f"{shlex.join(inside)}; echo $? >{code}; sleep 5"], check=True)
    keys, screen, until = (
        list(OPENED if "uvx" in block else AS_README_SAYS),
        "",
        time.monotonic() + PATIENCE_S,
    )
    while not (code.exists() and code.read_text().strip()) and time.monotonic() < until:
        time.sleep(0.5)
        screen = (
            subprocess.run([*tmux, "capture-pane", "-pS", "-"], capture_output=True, text=True).stdout
            or screen
        )
        if keys and re.search(keys[0][0], screen):
            subprocess.run([*tmux, "send-keys", keys.pop(0)[1]], check=True)
    subprocess.run([*tmux, "kill-server"], check=False)
    return (int(code.read_text()) if code.exists() else -1), screen
