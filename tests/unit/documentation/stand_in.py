"""What a page's lines call instead of a command: the same, with its placeholders filled in and made short.

Programs that run until Ctrl-C get it as soon as they have said something; those behind `&` run on.
"""

import fcntl
import os
import pty
import re
import shutil
import signal
import struct
import subprocess
import sys
import termios
import threading
from collections.abc import Collection, Sequence
from pathlib import Path

MODULES = {"capture-app": "capture_app.cli", "reconstruct": "reconstruction.cli"}
CAMERA = "sim:perfect,scene=bars"
CAMERA_NAMES = {"cam01": "perfect", "cam02": "perfect-2"}
TIMEOUT_S = 300
SHORTER: dict[tuple[str, ...], tuple[str, ...]] = {
    ("compare",): ("--max-instants=1", "--study=stereo"),
    ("tolerance",): ("--max-instants=2", "--max-offset-ms=34"),
    ("coverage",): ("--for-s=3",),
    ("burst",): ("--wait-s=120",),
    ("demo",): ("--cameras=2",),
    ("batch",): ("--instants=2",),
    ("calibrate",): ("--replace",),
    ("leader",): ("--host=127.0.0.1", "--port=0"),
    ("relay",): ("--host=127.0.0.1", "--port=0"),
    ("serve",): ("--port=0",),
    ("panel", "show"): ("--port=0",),
}
"""Options that a command gets where the line does not give them."""
FEWER: dict[str, tuple[str, ...]] = {
    "view": ("--frames=4", "--instants=3"),
    "splat": ("--iterations=2",),
}
"""Options that a command gets in the place of the line's, if it gives them: the last one counts."""
BOARD = "no sample shows a board: tests/system/end_to_end/test_newcomer.py renders one"
NOT_RUN = {
    frozenset({"calibrate", "charuco"}): BOARD,
    frozenset({"calibrate", "board"}): BOARD,
    frozenset({"calibrate", "--coverage"}): BOARD,
    frozenset(
        {"multiview"}
    ): "half a minute of all cores: tests/system/reconstruction/methods/multiview/test_multiview.py",
    frozenset({"--cluster"}): "needs a cluster: make test KIND=slurm",
}
"""Lines with these words are read by their commands, and not run, with the reason."""
STAYS = (
    ("leader",),
    ("node",),
    ("relay",),
    ("serve",),
    ("record",),
    ("panel", "show"),
    ("status", "--watch"),
)
ENDS = {"--save", "--seconds", "--detach", "--stop", "--help", "--at-boot", "--not-at-boot"}
CODES = {("coverage",): {0, 7}, ("doctor",): {0, 1, 6}}
"""Exit codes that are right besides 0: nobody holds a board there, a machine has its faults."""


def fill(word: str, sessions: Path) -> str:
    """Return a word of a line as this machine needs it."""
    leader = os.environ["DOCUMENTED_LEADER"]
    word = re.sub(r"^\[(.*)\]$", r"\1", word).removesuffix("...")
    word = re.sub(r"^(HOST|LEADER|GATE|192\.168\.\d+\.\d+)(:PORT|:\d+)?$", leader, word)
    word = re.sub(r"^(v4l2:/dev/video\d+|SPEC)$", CAMERA, word)
    word = {"SESSION": "sessions/burst-001", "SESSIONS": "sessions/burst-001", "ROOT": "sessions"}.get(
        word, word
    )
    if re.fullmatch(r"sessions/[\w-]+-\d{3}", word) and not Path(word).exists():
        kind = "led_panel" if "panel" in word else "jumper"
        shutil.copytree(sessions / kind, word)
    return word


def main() -> int:
    """Run the command that is this program's first argument."""
    _, name, *words = sys.argv
    if name not in MODULES:  # make and pip, whose lines test_command_lines.py checks
        return 0
    samples, names = Path(os.environ["DOCUMENTED_SAMPLES"]), CAMERA_NAMES if words[:1] == ["cameras"] else {}
    words = [names.get(word) or fill(word, samples) for word in words]
    give_own_folder(words)
    said = {word.partition("=")[0] for word in words}
    for path, options in SHORTER.items():
        if tuple(words[: len(path)]) == path and not said & ENDS:
            words += [option for option in options if option.partition("=")[0] not in said]
    words += [
        option for option in FEWER.get(words[0] if words else "", ()) if option.partition("=")[0] in said
    ]
    command = [sys.executable, "-m", MODULES[name], *words]
    for told, reason in NOT_RUN.items():
        if told <= set(words):
            print("not run:", name, *words, "--", reason, file=sys.stderr)
            return 0
    if words[:1] == ["compare"] and not is_first(said):
        print("run already with the same options:", name, *words, file=sys.stderr)
        return 0
    print("+", name, *words, file=sys.stderr, flush=True)
    if os.fstat(0).st_rdev == Path(os.devnull).stat().st_rdev:
        os.execv(command[0], command)
    if name == "capture-app" and (not words or words[0] == "--leader"):
        return look_at_screen(command)
    if any(set(path) <= set(words) and words[0] == path[0] for path in STAYS) and not said & ENDS:
        return interrupt_when_it_speaks(command)
    code = subprocess.run(command, check=False, stdin=subprocess.DEVNULL).returncode
    allowed = next((codes for path, codes in CODES.items() if tuple(words[: len(path)]) == path), {0})
    return 0 if code in allowed else code


def give_own_folder(words: list[str]) -> None:
    """The same folder in two lines is two folders here, and none is there yet."""
    if "--out" in words[:-1]:
        place = words.index("--out") + 1
        words[place] = f"{len(list(Path('results').glob('*')))}-{words[place]}"
        words[place] = str(Path("results") / words[place].replace("/", "-"))
        Path("results").mkdir(exist_ok=True)


def is_first(options: Collection[str]) -> bool:
    """Whether no line before had these options."""
    key = " ".join(sorted(option for option in options if option.startswith("--")))
    known = Path("compared")
    before = known.read_text().splitlines() if known.exists() else []
    known.write_text("\n".join((*before, key)))
    return key not in before


def interrupt_when_it_speaks(command: Sequence[str]) -> int:
    """Run a program until it has said that it runs, then press Ctrl-C."""
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    watchdog = threading.Timer(TIMEOUT_S, process.kill)
    watchdog.start()
    assert process.stdout is not None
    print(process.stdout.readline().decode(), end="", file=sys.stderr)
    process.send_signal(signal.SIGINT)
    print(process.stdout.read().decode(), end="", file=sys.stderr)
    code = process.wait()
    watchdog.cancel()
    # Its first word may come before it takes Ctrl-C as a request.
    return 0 if code in (0, 130, -signal.SIGINT) else code or 1


def look_at_screen(command: Sequence[str]) -> int:
    """Run a program of a terminal until it has drawn its screen, then end it."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))
    process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True)
    os.close(theirs)
    watchdog = threading.Timer(TIMEOUT_S, process.kill)
    watchdog.start()
    seen = b""
    try:
        while b"Shoot" not in seen:
            seen += os.read(ours, 65536)
    except OSError:
        pass
    process.terminate()
    threading.Thread(target=_drain, args=(ours,), daemon=True).start()
    process.wait()
    watchdog.cancel()
    return 0 if b"Shoot" in seen else 1


def _drain(terminal: int) -> None:
    try:
        while os.read(terminal, 65536):
            pass
    except OSError:
        pass


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.exit(main())
