"""Exposure, gain, white balance and focus on the kernel's own uvcvideo driver, in a virtual machine.

`make test-v4l2` runs it. `usb_cameras_with_controls.py` is what the driver talks to, over the USB bus.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from capture_app.session.reading.reader import Session
from tests.end_to_end.test_v4l2_rig import BOOT_SECONDS, MACHINE, REPOSITORY, camera_vm

__all__ = ["camera_vm"]

pytestmark = [pytest.mark.v4l2, pytest.mark.timeout(900)]

RIG = """
app() {{ {command} "$@"; }}
export PYTHONDONTWRITEBYTECODE=1 PYTHONPATH={repository}
cd {repository}
python3 {cameras} {camera_vm} /out/usb.txt >/out/usb_cameras.log 2>&1 &
until [ -e /dev/video2 ]; do sleep .1; done
sleep 1
app leader --host 127.0.0.1 --port 47010 --sessions /tmp/sessions 2>/out/leader.log &
for side in 0:left 2:right; do
  app node --name ${{side#*:}} --camera v4l2:/dev/video${{side%:*}} --leader 127.0.0.1:47010 \\
    2>/out/${{side#*:}}.log &
done
for _ in $(seq 60); do
  [ "$(cat /out/left.log /out/right.log | grep -c ': syncing')" -lt 2 ] || break
  sleep .5
done
sleep 6
at="--leader 127.0.0.1:47010"
echo burst >>/out/usb.txt
app burst $at --frames 5 2>/out/burst.log
cp -r /tmp/sessions /out/sessions
echo match >>/out/usb.txt
app cameras match left $at --json >/out/matched.json 2>/out/match.log
echo auto >>/out/usb.txt
app cameras set exposure=auto --camera left $at --json >/out/auto.json 2>/out/auto.log
"""


@pytest.fixture(scope="module")
def out(camera_vm: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One boot: a burst with automatic exposures, then all like the left camera, then that one automatic."""
    folder = tmp_path_factory.mktemp("controls")
    script = RIG.format(
        command=Path(sys.executable).with_name("capture-app"),
        repository=REPOSITORY,
        cameras=Path(__file__).with_name("usb_cameras_with_controls.py"),
        camera_vm=camera_vm,
    )
    done = subprocess.run(
        ["bash", camera_vm / "boot.sh", script],
        env={**os.environ, **MACHINE, "OUT": str(folder)},
        capture_output=True,
        text=True,
        timeout=BOOT_SECONDS + 60,
        check=False,
    )
    logs = "\n".join(f"--- {log.name}\n{log.read_text()}" for log in sorted(folder.glob("*.log")))
    told = (folder / "auto.json").is_file() and (folder / "auto.json").read_text()
    assert told, f"the rig did not finish (exit {done.returncode})\n{done.stderr}\n{logs}"
    return folder


def what_was_set(out: Path, part: str) -> list[tuple[str, int, int, int]]:
    """What the driver has set in one part of the run: side, unit, selector and value, in their order."""
    after = (out / "usb.txt").read_text().split(f"{part}\n")[1]
    lines = [line.split() for line in after.split("match\n")[0].split("auto\n")[0].splitlines()]
    return [(side, int(unit), int(selector), int(value)) for side, _, unit, selector, value in lines]


def controls(out: Path, name: str) -> dict[str, dict[str, Any]]:
    found = json.loads((out / name).read_text())["cameras"]
    return {one["camera"]: one["state"] for one in found}


def test_automatic_exposures_are_locked_while_a_burst_is_picked(out: Path) -> None:
    for side in ("left", "right"):
        done = [(selector, value) for name, _, selector, value in what_was_set(out, "burst") if name == side]
        (mode, manual), (exposure, value), *_, (last, automatic) = done
        assert (mode, manual, exposure, last, automatic) == (2, 1, 4, 2, 8)
        images = Session.open(out / "sessions" / "burst-001").manifest.images
        assert {image.exposure_ns for image in images if image.camera == side} == {value * 100_000}


def test_what_one_webcam_has_chosen_is_set_on_the_other(out: Path) -> None:
    done = controls(out, "matched.json")
    exposures = {side: state["controls"][0] for side, state in done.items()}
    assert exposures["left"]["value"] == exposures["right"]["value"]
    assert not any(state.get("automatic") for state in exposures.values())
    set_there = {(side, unit, selector): value for side, unit, selector, value in what_was_set(out, "match")}
    assert set_there["right", 1, 4] == set_there["left", 1, 4] == exposures["left"]["value"] / 100
    assert set_there["right", 2, 10] == 4600
    assert set_there["right", 2, 11] == 0


def test_what_a_webcam_cannot_do_is_said(out: Path) -> None:
    problems = controls(out, "matched.json")["right"]["problems"]
    assert problems["focus"] == "it has no control of its focus"
    assert "steps of LabCam 1, and was measured in steps of LabCam 0" in problems["gain"]


def test_a_webcam_goes_back_to_choosing_itself(out: Path) -> None:
    assert controls(out, "auto.json")["left"]["controls"][0]["automatic"]
    assert ("left", 1, 2, 8) in what_was_set(out, "auto")
