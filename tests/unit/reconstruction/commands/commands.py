"""Every command of `reconstruct` that reads a session, as short as it can be, and how each must end."""

import json
from pathlib import Path

from capture_app.common.errors import ExitCode
from tests.unit.reconstruction.commands.server import Run

MAX_BYTES = 4_000_000_000
COMMANDS: dict[str, tuple[str, ...]] = {
    "stereo": ("stereo", "SESSION", "--out", "OUT"),
    "stereo of a pair": ("stereo", "SESSION", "--pair", "left,right", "--out", "OUT"),
    "tolerance": ("tolerance", "SESSION", "--max-instants", "1", "--max-offset-ms", "34"),
    "compare": ("compare", "SESSION", "--max-instants", "1", "--max-multiview-instants", "1",
                "--offset-ms", "34", "--out", "OUT"),
    "panorama": ("panorama", "SESSION", "--out", "OUT"),
    "panorama of pictures": ("panorama", "PICTURES", "--out", "OUT"),
    "multiview": ("multiview", "SESSION", "--out", "OUT"),
    "calibrate from session": ("calibrate", "SESSION", "--from", "session"),
    "batch": ("batch", "SESSION", "--instants", "0", "--jobs", "1", "--out", "OUT"),
    "calibrate from charuco": ("calibrate", "SESSION", "--from", "charuco", "--replace"),
    "calibrate from sfm": ("calibrate", "SESSION", "--from", "sfm", "--replace"),
}  # fmt: skip
"""The last two do not read the session's calibration; the last one replaces it."""


def command_line(name: str, session: Path, out: Path) -> list[str]:
    """The arguments of a command for a session, with --json."""
    words = {"SESSION": str(session), "OUT": str(out), "PICTURES": str(session / "images" / "rig1" / "left")}
    return [*(words.get(word, word) for word in COMMANDS[name]), "--json"]


def faults(run: Run) -> list[str]:
    """What is wrong with how a run ended: it is to leave a line and an exit code, or JSON of a result."""
    found = []
    if run.code not in set(ExitCode):
        found.append(f"exit code {run.code}")
    if "Traceback" in run.err or "unexpected " in run.err:
        found.append("an exception that nobody has foreseen")
    errors = [line for line in run.talk if line.startswith("reconstruct: error: ")]
    if run.code and (len(errors) != 1 or len(run.talk) != len(errors) + sum(map(_explains, run.talk))):
        found.append(f"{len(run.talk)} lines on stderr with exit code {run.code}")
    if not run.code and errors:
        found.append("an error with exit code 0")
    if run.out or not run.code:
        try:
            json.loads(run.out)
        except ValueError:
            found.append("no JSON on stdout")
    if run.peak_bytes > MAX_BYTES:
        found.append(f"{run.peak_bytes / 1e9:.1f} GB of memory")
    return found


def _explains(line: str) -> bool:
    """Whether a line says what of a batch has no result, why a camera is left out, or what was found."""
    explained = (": failed: ", ": not applicable: ", " is left out: ", " this one was found: ")
    return any(said in line for said in explained)
