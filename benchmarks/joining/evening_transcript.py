"""The first evening on a bare machine, in a real terminal: what is typed, what the screen says, and when.

A newcomer installs, starts the screen, lets it simulate cameras in the place of own ones, and takes a burst;
a second machine joins by a code, and a burst of all is taken. The two are network namespaces on one cable,
each with a home of its own. The screen is read four times a second. Said of each step: how long it took; the
longest time in which the screen did not change meanwhile; and the longest in which it did not say what is
waited for. Needs root, tmux, iproute2 and Python alone, and a clone that it may install from:

    python3 benchmarks/joining/evening_transcript.py [--no-install] > transcript.txt
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

LOOK_EVERY_S, PATIENCE_S = 0.25, 900.0
ASKED_S = 2.0
COLUMNS, ROWS = "120", "40"
PROMPT = "$ "
FIGURES, WORDS = re.compile(r"[\d.,]+"), re.compile(r"\w")
PLOTS = re.compile("[─-╿▀-▟┈▁▔█░ ]{2,}|[│▌▐]")
"""Frames, traces and pictures: they are no words."""
NOTHING_YET = r"^(?!)"
"""A step that says nothing until it is done; what is typed is no news."""


class Pane:
    """A terminal of one machine."""

    def __init__(self, title: str, home: Path, inside: tuple[str, ...] = ()) -> None:
        self.title, self._server = title, f"evening-{os.getpid()}-{title}"
        self._seen: set[str] = set()
        home.mkdir(parents=True, exist_ok=True)
        kept = {name: os.environ[name] for name in os.environ if name.lower().endswith("_proxy")}
        kept |= {
            name: os.environ[name] for name in os.environ if name.startswith(("PIP_", "SSL_", "REQUESTS_"))
        }
        words = {"HOME": str(home), "PATH": os.environ["PATH"], "TERM": "xterm-256color", "LANG": "C.UTF-8"}
        words |= {"COLORTERM": "truecolor", "PS1": PROMPT, "SIMULSHOT_OPEN": "0", **kept}
        shell = [*inside, "env", "-i", *(f"{name}={value}" for name, value in words.items()), "sh"]
        self._tmux("-f", "/dev/null", "new-session", "-d", "-x", COLUMNS, "-y", ROWS, *shell)
        self._tmux("set-option", "-g", "status", "off")
        self._tmux("resize-window", "-x", COLUMNS, "-y", ROWS)

    @property
    def screen(self) -> str:
        """What it shows now."""
        return self._tmux("capture-pane", "-p").replace("\u00a0", " ").replace("\u202f", " ")

    def press(self, *keys: str) -> None:
        """Press keys, by tmux's names, or type text."""
        self._tmux("send-keys", *keys)

    def news(self, screen: str) -> list[str]:
        """Return the lines that were not there before but for their figures."""
        lines = [PLOTS.sub(" ", line).strip() for line in screen.splitlines()]
        lines = [line for line in lines if len(WORDS.findall(line)) > 1]
        fresh = [line for line in lines if FIGURES.sub("", line) not in self._seen]
        self._seen |= {FIGURES.sub("", line) for line in lines}
        return fresh

    def close(self) -> None:
        """End it."""
        self._tmux("kill-server")

    def _tmux(self, *words: str) -> str:
        done = subprocess.run(
            ["tmux", "-u", "-L", self._server, *words], capture_output=True, text=True, check=True
        )
        return done.stdout


class Transcript:
    """What is printed, and the figures of its steps."""

    def __init__(self) -> None:
        self._began_s = time.monotonic()
        self.rows: list[tuple[str, float, float, float]] = []

    def step(self, pane: Pane, name: str, keys: tuple[str, ...], awaited: str, says: str) -> str:
        """Press keys, and wait until the screen has what is awaited; return the screen then.

        `says`: what on the screen tells that it is under way.
        """
        print(f"\n## {self._now()} {pane.title}: {name} [{' '.join(keys)}]", flush=True)
        before = pane.screen
        if keys:
            pane.press(*keys)
        began_s = changed_s = said_s = time.monotonic()
        still_s = unsaid_s = 0.0
        while True:
            screen, now_s = pane.screen, time.monotonic()
            for line in pane.news(screen):
                print(f"{self._now()} {line}", flush=True)
            if screen != before:
                before, changed_s = screen, now_s
            if re.search(says, screen, re.MULTILINE):
                said_s = now_s
            still_s, unsaid_s = max(still_s, now_s - changed_s), max(unsaid_s, now_s - said_s)
            if re.search(awaited, screen, re.MULTILINE):
                break
            if now_s - began_s > PATIENCE_S:
                raise SystemExit(f"{awaited!r} did not come; the screen is\n{screen}")
            time.sleep(LOOK_EVERY_S)
        self.rows.append((f"{pane.title}: {name}", now_s - began_s, still_s, unsaid_s))
        return screen

    def _now(self) -> str:
        return f"{time.monotonic() - self._began_s:7.2f} s"

    def table(self) -> None:
        """Print the figures."""
        width = max(len(name) for name, *_ in self.rows)
        print(f"\n{'step':{width}}  seconds  screen as it was  unsaid")
        for name, seconds, still_s, unsaid_s in self.rows:
            print(f"{name:{width}}  {seconds:7.2f}  {still_s:16.2f}  {unsaid_s:6.2f}")


def cable() -> list[subprocess.Popen[bytes]]:
    """Make two machines with a cable between them; they are there as long as these processes."""
    ends = [subprocess.Popen(["unshare", "-n", "sleep", "infinity"]) for _ in range(2)]
    own = Path("/proc/self/ns/net").readlink()
    while any(Path(f"/proc/{end.pid}/ns/net").readlink() == own for end in ends):
        time.sleep(0.05)
    one, other = (str(end.pid) for end in ends)
    name = f"evening{os.getpid()}"
    ip = shutil.which("ip", path=os.environ["PATH"] + ":/usr/sbin:/sbin") or "ip"
    subprocess.run([ip, "link", "add", name, "type", "veth", "peer", "name", f"{name}b"], check=True)
    for number, (pid, device) in enumerate(((one, name), (other, f"{name}b")), 1):
        subprocess.run([ip, "link", "set", device, "netns", pid, "name", "eth0"], check=True)
        inside = ["nsenter", "-t", pid, "-n", ip]
        subprocess.run([*inside, "address", "add", f"10.77.0.{number}/24", "dev", "eth0"], check=True)
        for device in ("lo", "eth0"):
            subprocess.run([*inside, "link", "set", device, "up"], check=True)
        subprocess.run([*inside, "route", "add", "default", "dev", "eth0"], check=True)
    return ends


def inside(machine: subprocess.Popen[bytes]) -> tuple[str, ...]:
    """Return the command that runs another one on that machine."""
    return ("nsenter", "-t", str(machine.pid), "-n")


def evening(script: Transcript, home: Path, cameras: int, *, install: bool) -> None:
    """Type it all."""
    machines, panes = cable(), []
    try:
        if install:
            panes.append(shop := Pane("shop", home / "one"))
            script.step(
                shop,
                "make install",
                ('make install; echo "done: $?"', "Enter"),
                r"^done: \d",
                "installing|cloning|^done",
            )
        panes.append(one := Pane("one", home / "one", inside(machines[0])))
        typed = ("capture-app", "Enter")
        script.step(one, "the screen", typed, "What shall take pictures", "One moment|What shall")
        fewer = ("-",) * (5 - cameras)
        script.step(
            one,
            "cameras of its own",
            (*fewer, "s"),
            f"{cameras} cameras ready",
            "Starting|joining|syncing|aligning|start|coarse",
        )
        script.step(one, "the mode Shoot", ("2",), "Next take", NOTHING_YET)
        under_way = r"ordered|are saving|waiting|of \d+ images|─ burst-00\d ─"
        script.step(one, "the first take", ("Space",), "─ burst-001 ─", under_way)
        screen = script.step(one, "a code for another", ("1", "i"), r"once: \d{4}", NOTHING_YET)
        found = re.search(r"once: (\d{4}.?\d{4})", screen)
        assert found is not None, screen
        panes.append(other := Pane("other", home / "other", inside(machines[1])))
        node = "capture-app node --camera sim:phone-b --clock sim"
        script.step(other, "a node", (node, "Enter"), "Its code, 8 digits", "look|found|leader")
        joined = (found[1], "Enter")
        script.step(other, "its code", joined, r"ready", "known|join|sync|align")
        # A key too soon after Escape would be Alt with that key.
        rig = rf"\A(?!(?:.|\n)*Another machine)(?:.|\n)*{cameras + 1} cameras ready"
        script.step(one, "the rig with it", ("Escape",), rig, "joining|syncing|aligning|known as")
        script.step(one, "the mode Shoot again", ("2",), "Next take", NOTHING_YET)
        script.step(one, "a take of all", ("Space",), "─ burst-002 ─", under_way)
        script.step(one, "the question at the end", ("q",), "Stop the rig", NOTHING_YET)
        script.step(one, "the end", ("s",), rf"^{re.escape(PROMPT.strip())}\s*$", "Stopping|is stopped")
        script.step(other, "what the node says then", (), "lost|left|silent|gone", NOTHING_YET)
        other.press("C-c")
    finally:
        for pane in panes:
            print(f"\n## the last screen of {pane.title}\n{pane.screen.rstrip()}")
            pane.close()
        for machine in machines:
            machine.kill()


def main() -> int:
    """Print the transcript; 1 where something was awaited and unsaid for too long."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--no-install", action="store_true", help="capture-app is on the PATH already")
    parser.add_argument("--cameras", type=int, default=2, help="simulated cameras of the first machine (2)")
    options = parser.parse_args()
    script = Transcript()
    with tempfile.TemporaryDirectory(prefix="evening-") as home:
        try:
            evening(script, Path(home), options.cameras, install=not options.no_install)
        finally:
            script.table()
    longest_s = max(unsaid_s for *_, unsaid_s in script.rows)
    print(f"the longest unsaid: {longest_s:.2f} s (asked: {ASKED_S:g})")
    print(f"load average of the machine: {os.getloadavg()[1]:.1f}")
    return int(longest_s > ASKED_S)


if __name__ == "__main__":
    sys.exit(main())
