"""Live people of a rig of processes whose cameras replay the jumper's pictures."""

from pathlib import Path

import pytest

from capture_app import AsyncRig
from capture_app.common.errors import ExitCode, NotAvailableError
from reconstruction.methods.people.blazepose_weights import find_weights
from tests.project import JUMPER
from tests.system.end_to_end.conftest import Start
from tests.system.end_to_end.rig import lead
from tests.waiting import SLOW_PATIENCE_S, time_limit


async def test_the_jumper_is_a_person_with_joints_and_errors(start: Start, tmp_path: Path) -> None:
    try:
        find_weights("full")
    except NotAvailableError:
        pytest.skip("the weights of BlazePose were never fetched")
    leader, at = await lead(start, tmp_path / "sessions")
    alone = await start("people", "--leader", at)
    await alone.finish()
    assert alone.process.returncode == ExitCode.INCOMPLETE
    assert "0 cameras: a joint in 3D needs two" in alone.said[-1]
    names = [folder.name for folder in sorted((JUMPER / "images" / "rig1").iterdir())]
    for name in names:
        camera = f"replay:{JUMPER},camera={name}"
        await start("node", "--name", name, "--camera", camera, "--leader", at)
    async with AsyncRig(at) as rig:
        await rig.wait_until_ready(len(names), SLOW_PATIENCE_S)
        people = await start("people", "--leader", at, "--json")
        assert "not calibrated" in (await people.next_json())["problem"]
        await rig.burst(1)  # which has the recording's calibration
    async with time_limit("a person", SLOW_PATIENCE_S):
        while not (found := await people.next_json())["people"]:
            pass
    joints = next(iter(found["people"].values()))
    assert len(joints) > 10
    # A joint that one camera sees elsewhere has the error of that, which may be metres.
    errors = sorted(error for *_, error in joints.values())
    assert errors[0] > 0
    assert errors[len(errors) // 2] < 0.5, errors
    assert found["unit"] == "m"
    assert found["late_ns"] > 0
    await people.stop()
    await leader.stop()
