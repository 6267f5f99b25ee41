"""A rig in the background, under Windows: `python background_rig.py PORT SESSIONS SECONDS`."""

import os
import subprocess
import sys
import time

port, sessions, seconds = sys.argv[1:]
leader = ("--leader", f"127.0.0.1:{port}")
os.environ["SIMULSHOT_OPEN"] = "1"


def capture_app(*arguments: str) -> str:
    """Run a command, print what it says, and return that; it must succeed."""
    command = (sys.executable, r"Z:\kit\cli.py", "capture-app", *arguments)
    run = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=240, check=False)
    said = (run.stdout + run.stderr).decode()
    sys.stdout.buffer.write(f"$ {' '.join(arguments)}\n{said}\n".encode())
    sys.stdout.flush()
    assert run.returncode == 0
    return said


cameras = ("--camera", "sim:pi", "--camera", "sim:phone-a")
capture_app("rig", "start", "--sessions", sessions, "--port", port, *cameras)
# To ask whether a process runs must not end it.
for _ in range(3):
    assert port in capture_app("rig", "list")
end_s = time.monotonic() + 60
while "2 cameras ready" not in capture_app("status", *leader):
    assert time.monotonic() < end_s
    time.sleep(1)
capture_app("burst", *leader, "--name", "b")
capture_app("record", *leader, "--seconds", seconds, "--name", "r", "--max-missing", "100")
for name in ("b-001", "r-001"):
    assert "are intact" in capture_app("sessions", "verify", rf"{sessions}\{name}")
capture_app("rig", "stop", *leader)
while port in capture_app("rig", "list"):
    assert time.monotonic() < end_s + 60
    time.sleep(1)
