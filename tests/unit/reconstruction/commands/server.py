"""Runs `reconstruct` in real processes, each forked from one that has loaded the libraries already.

Started by itself, it reads a line of JSON for each run, {"arguments": [...], "folder": "..."}, and answers
with how it ended. Libraries are imported before a fork, and no more: threads of theirs would be lost.
"""

import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

LIMIT_BYTES = 12 << 30
"""Address space of a run, which is several times what it uses: it saves the machine, and decides nothing."""
TIMEOUT_S = 900


@dataclass(frozen=True)
class Run:
    """How a run ended: exit code (negative: the signal that ended it), what it printed, peak memory, time."""

    code: int
    out: str
    err: str
    peak_bytes: int
    seconds: float

    @property
    def talk(self) -> list[str]:
        """The lines on stderr, but for those of progress."""
        return [line for line in self.err.splitlines() if line.strip() and not line.startswith("[")]


class Server:
    """The process that forks."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def run(self, folder: Path, *arguments: object) -> Run:
        """Run a command line; `folder` is for what it prints, and for calibrations that it keeps."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        asked = {"arguments": [str(one) for one in arguments], "folder": str(folder)}
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()
        return Run(**json.loads(self._process.stdout.readline()))

    def close(self) -> None:
        """End it."""
        # Leaving it closes its pipes and waits; it ends as no more is asked of it.
        with self._process:
            pass


def _fork(folder: Path, arguments: list[str]) -> Run:
    began = time.monotonic()
    files = folder / "stdout", folder / "stderr"
    child = os.fork()
    if not child:
        os.environ["XDG_DATA_HOME"] = str(folder / "data")
        _child(arguments, *files)
    _, status, usage = os.wait4(child, 0)
    out, err = (file.read_text(errors="replace") for file in files)
    seconds = time.monotonic() - began
    return Run(os.waitstatus_to_exitcode(status), out, err, usage.ru_maxrss << 10, seconds)


def _child(arguments: list[str], out: Path, err: Path) -> None:
    code = 70
    try:
        for stream, file in ((1, out), (2, err)):
            handle = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(handle, stream)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (TIMEOUT_S, TIMEOUT_S))
        from reconstruction import cli

        sys.argv = ["reconstruct", *arguments]
        try:
            cli.main()
        except SystemExit as ended:
            code = int(ended.code or 0)
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:
        import traceback

        traceback.print_exc()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _main() -> None:
    from contextlib import suppress
    from importlib import import_module

    for name in (
        "cv2",
        "pycolmap",
        "open3d",
        "reconstruction.compare.comparison",
        "reconstruction.methods.panorama.panorama_run",
    ):
        with suppress(ImportError):
            import_module(name)
    for line in sys.stdin:
        asked = json.loads(line)
        print(json.dumps(vars(_fork(Path(asked["folder"]), asked["arguments"]))), flush=True)


if __name__ == "__main__":
    _main()
