"""A rig with a camera whose stamps are 15 ms late: what sessions say of their spread, held against the truth.

    python -m benchmarks.time_offsets.biased_camera

Real processes on this machine: a leader and three nodes with simulated cameras before the jumping child, one
of them late without knowing it; `cameras calibrate-time` measures it by motion, with bursts before and after.
Several minutes, as some 200 pictures are rendered.
"""

import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from benchmarks.report import Columns, Report, new_parser, print_report, print_rows, talk
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import judge

BIAS_MS = 15.0
CAMERAS = {"cam01": "phone-a", "cam02": "phone-b", "cam03": f"phone-a,stamp_bias_ms={BIAS_MS:g}"}
LATE = "cam03"
COLUMNS: Columns = {
    "when": ("stamps", ""),
    "told_ms": ("spread told, ms", ".3f"),
    "error_ms": ("± (95 %)", ".3f"),
    "true_ms": ("true spread", ".3f"),
    "late_ms": ("late camera off by", ".3f"),
    "late_error_ms": ("± (95 %)", ".3f"),
    "inside": ("inside", ""),
}


def _command(*words: str) -> list[str]:
    return [sys.executable, "-m", "capture_app.cli", *words]


def _run(environment: Mapping[str, str], *words: str) -> dict[str, Any]:
    done = subprocess.run(
        _command(*words, "--json"), stdout=subprocess.PIPE, text=True, check=False, env=environment
    )
    if not done.stdout:
        raise SystemExit(f"{' '.join(words)} ended with {done.returncode}")
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def _rows(when: str, folder: str) -> list[Report]:
    """A row for each instant: what the session says, and the truth; times in ms."""
    session = Session.open(Path(folder))
    truth, verdict = session.true_times(), judge(session.manifest)
    assert truth is not None
    assert verdict.spread_error_ns is not None
    # Nodes and leader run on this host's clock: its true time is the leader's.
    true_ns = {(one.camera, one.instant): one.true_ns for one in truth.images}
    rows = []
    for instant, of in enumerate(session.images_by_instant()):
        images = list(of.values())
        true = [true_ns[image.camera, instant] for image in images]
        told = [image.leader_ns for image in images]
        spread, true_spread = max(told) - min(told), max(true) - min(true)
        late = next(image for image in images if image.camera == LATE)
        rows.append(
            {
                "when": when,
                "told_ms": spread / 1e6,
                "error_ms": verdict.spread_error_ns / 1e6,
                "true_ms": true_spread / 1e6,
                "late_ms": (late.leader_ns - true_ns[LATE, instant]) / 1e6,
                "late_error_ms": (late.uncertainty_ns or 0) / 1e6,
                "inside": "yes" if abs(spread - true_spread) <= verdict.spread_error_ns else "NO",
            }
        )
    return rows


def main() -> None:
    """Run the rig, and print the table."""
    parser = new_parser(__doc__)
    parser.add_argument("--frames", type=int, default=3, help="of each burst (3)")
    parser.add_argument("--seconds", type=float, default=2.0, help="of motion (2)")
    parser.add_argument("--scale", type=float, default=0.3, help="size of the pictures (0.3)")
    given = parser.parse_args()
    with ExitStack() as stack, tempfile.TemporaryDirectory() as folder:
        # No profile, key, rig or spool of this user's has a part in it.
        environment = {**os.environ, "XDG_DATA_HOME": folder, "XDG_STATE_HOME": folder}
        sessions = f"{folder}/sessions"

        def start(*words: str) -> "subprocess.Popen[str]":
            child = subprocess.Popen(
                _command(*words),
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                env=environment,
            )
            stack.callback(child.wait)
            stack.callback(child.kill)
            return child

        leader = start("leader", "--host", "127.0.0.1", "--port", "0", "--sessions", sessions, "--json")
        assert leader.stdout is not None
        at = json.loads(leader.stdout.readline())["leader"]
        # A pipe that nobody empties would hold the leader up.
        threading.Thread(target=leader.stdout.read, daemon=True).start()
        for name, model in CAMERAS.items():
            camera = f"sim:{model},scene=studio,scale={given.scale:g}"
            start("node", "--name", name, "--camera", camera, "--leader", at, "--clock", "sim")
        take = ("burst", "--leader", at, "--frames", str(given.frames), "--wait-s", "300", "--min-nodes", "3")
        talk("before it is measured")
        rows = _rows("assumed", _run(environment, *take)["session"])
        talk("measuring")
        measure = ("cameras", "calibrate-time", "--leader", at, "--seconds", str(given.seconds))
        measured = _run(environment, *measure, "--wait-s", "300", "--min-nodes", "3")
        rows += _rows("by motion", _run(environment, *take)["session"])
    report: Report = {"rows": rows, "calibration": measured["cameras"], "bias_ms": BIAS_MS}
    print_report(report, lambda found: print_rows(found["rows"], COLUMNS), as_json=given.json)


if __name__ == "__main__":
    main()
