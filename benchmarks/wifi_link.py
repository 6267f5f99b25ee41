"""The emulated WiFi link of `../shared/wifi-link` for benchmarks: namespaces, wiring, and its emulator."""

import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WIFI_LINK = ROOT.parent / "shared" / "wifi-link"


def why_not() -> str:
    """Why the link cannot be had here; empty where it can."""
    if not (WIFI_LINK / "linkemu.c").is_file():
        return f"the link's emulator is not at {WIFI_LINK.relative_to(ROOT.parent)} beside the checkout"
    if not sys.platform.startswith("linux") or os.geteuid() != 0:
        return "network namespaces need Linux and root"
    missing = [tool for tool in ("ip", "cc", "bash") if shutil.which(tool) is None]
    return f"{', '.join(missing)} is not installed" if missing else ""


@contextlib.contextmanager
def namespaces(pairs: int, wiring: Sequence[str] = ()) -> Iterator[None]:
    """Set up so many pairs of namespaces, and more by commands of their own; take all down again."""
    try:
        # A run that was killed may have left its own behind.
        _bash("teardown.sh", check=True)
        _bash("setup.sh", str(pairs), check=True)
        for command in wiring:
            subprocess.run(command.split(), check=True, stdout=subprocess.DEVNULL)
        yield
    finally:
        _bash("teardown.sh", check=False)


def build_emulator(folder: Path) -> Path:
    """Compile the program that delays what crosses the link."""
    emulator, source = folder / "linkemu", str(WIFI_LINK / "linkemu.c")
    subprocess.run([shutil.which("cc") or "cc", "-O2", "-w", "-o", str(emulator), source, "-lm"], check=True)
    return emulator


@contextlib.contextmanager
def running(*command: str, **environment: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process that is ended with the block; `environment` adds to this one's."""
    process = subprocess.Popen(
        command, cwd=ROOT, stderr=subprocess.DEVNULL, env={**os.environ, **environment}
    )
    try:
        yield process
    finally:
        process.terminate()
        process.wait(timeout=20)


def _bash(script: str, *arguments: str, check: bool) -> None:
    subprocess.run(["bash", str(WIFI_LINK / script), *arguments], check=check, stdout=subprocess.DEVNULL)
