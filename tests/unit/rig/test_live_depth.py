"""Live depth: from previews of one instant, by a process of its own, and what is said when there is none."""

from contextlib import aclosing
from pathlib import Path

import cv2
import pytest

from capture_app.common.errors import SimulshotError
from capture_app.protocol.status import Preview
from capture_app.rig import live_pictures as module
from capture_app.rig.live_pictures import live_depth
from capture_app.session.reading.decoding import decode_preview
from tests.facts import make_facts
from tests.project import JUMPER
from tests.unit.tui.fake_rig import FakeRig, make_node
from tests.waiting import time_limit

CAMERAS = ("cam00", "cam01", "cam04", "cam05", "cam06")


def calibrated_rig(folder: Path) -> FakeRig:
    """A rig of the jumper's cameras and one more, which is calibrated if their session is in `sessions`."""
    rig = FakeRig()
    facts = make_facts(kind="sim", model="Simulated phone A", width=640, height=480)
    rig.nodes = tuple(make_node(name, camera=facts) for name in (*CAMERAS, "door"))
    rig.different = {"sessions_folder": str(folder / "sessions")}
    return rig


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeRig:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return calibrated_rig(tmp_path)


def show(rig: FakeRig, instant: int) -> None:
    """Let the cameras show an instant of the jumper's."""
    for name in CAMERAS:
        jpeg = (JUMPER / "images" / "rig1" / name / f"{instant:06}.jpg").read_bytes()
        small = cv2.resize(decode_preview(jpeg), (160, 120), interpolation=cv2.INTER_AREA)
        rig.tell(
            Preview(
                camera=name,
                leader_ns=instant,
                instant_ns=instant,
                width=160,
                height=120,
                jpeg=cv2.imencode(".jpg", small)[1].tobytes(),
                completes=name == CAMERAS[-1],
            )
        )


async def test_the_death_of_the_process_is_told(rig: FakeRig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "COMMAND", ("timeit", "-n1", "-r1", "import os; os.kill(os.getpid(), 9)"))
    async with time_limit("the error"), aclosing(live_depth(rig, rig.status(), lambda: "cam04")) as found:
        show(rig, 0)
        with pytest.raises(SimulshotError, match="reconstruct live ended with code -9: it printed nothing"):
            await anext(found)
