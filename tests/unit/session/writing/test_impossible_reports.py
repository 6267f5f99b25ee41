"""A camera that reports impossible numbers is left out and named; the others' session opens and verifies."""

import asyncio
import json
from os import sep
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs

from capture_app.common.address import Address
from capture_app.common.errors import BadInputError
from capture_app.machine.repair import repair
from capture_app.protocol.log import Log
from capture_app.session.format.burst_plan import PLAN
from capture_app.session.format.manifest import JOURNAL, CameraRecord
from capture_app.session.reading.verify import verify
from tests.unit.session.conftest import CLOCK, camera_record, jpeg
from tests.unit.session.writing.full_take import Take


def impossible(name: str, value: int) -> list[CameraRecord]:
    """A camera whose report has this number in one place after the other."""
    camera = camera_record(name)
    facts = [structs.replace(camera.facts, **{key: value}) for key in ("row_time_ns", "exposure_ns")]
    clocks = [structs.replace(CLOCK, **{key: value}) for key in ("offset_ns", "uncertainty_ns")]
    return [structs.replace(camera, facts=one) for one in facts] + [
        structs.replace(camera, clock=one) for one in clocks
    ]


@pytest.mark.parametrize("value", [2**62, 2**63, 2**70])
def test_a_camera_with_impossible_numbers_costs_itself_only(tmp_path: Path, value: int) -> None:
    for number, broken in enumerate(impossible("cam1", value)):
        take = Take(tmp_path / str(number))
        writer = take.begin()
        for name, instant in take.places:
            take.add(writer, name, instant)
        session = writer.finish([camera_record("cam0"), broken], take.burst, origin="simulated")
        assert [camera.name for camera in session.manifest.cameras] == ["cam0"]
        assert "cam1 is left out" in session.manifest.note
        assert len(session.manifest.images) == take.instants
        assert verify(session) == []
        true_times = session.true_times()
        assert true_times is not None
        assert {time.camera for time in true_times.images} == {"cam0"}, "of images that are there"
        assert (take.folder / "set_aside/images/rig1/cam1/000002.jpg").is_file()


@pytest.mark.parametrize(
    ("field", "value"), [("leader_ns", 2**62), ("leader_ns", -(2**62)), ("exposure_ns", 2**62)]
)
def test_an_image_with_an_impossible_number_is_refused(tmp_path: Path, field: str, value: int) -> None:
    take = Take(tmp_path)
    with take.begin() as writer:
        take.add(writer, "cam0", 0)
        times: dict[str, Any] = {"leader_ns": 0} | {field: value}
        with pytest.raises(BadInputError, match="cam1"):
            writer.add_image(jpeg(1), camera="cam1", instant=0, **times)


def test_repair_leaves_out_a_camera_whose_plan_is_impossible(tmp_path: Path) -> None:
    take = Take(tmp_path)
    with take.begin() as writer:
        for name, instant in take.places:
            take.add(writer, name, instant)
    plan = json.loads((take.folder / PLAN).read_bytes())
    plan["cameras"][1]["camera"]["facts"]["row_time_ns"] = 2**63
    (take.folder / PLAN).write_text(json.dumps(plan))
    journal = (take.folder / JOURNAL).read_text().splitlines()
    wrong = json.loads(journal[0]) | {"leader_ns": 2**62, "residual_ns": 2**62}
    (take.folder / JOURNAL).write_text("\n".join([json.dumps(wrong), *journal[1:]]) + "\n")
    take.confirmed = {key: data for key, data in take.confirmed.items() if key[0] == "cam0" and key[1] > 0}
    session = take.check_repaired()
    assert len(session.manifest.images) == 2
    assert "cam1 is left out" in session.manifest.note


def test_repair_says_what_to_do_where_no_camera_is_left(tmp_path: Path) -> None:
    take = Take(tmp_path)
    with take.begin() as writer:
        take.add(writer, "cam0", 0)
    plan = json.loads((take.folder / PLAN).read_bytes())
    for camera in plan["cameras"]:
        camera["camera"]["facts"]["row_time_ns"] = 2**63
    (take.folder / PLAN).write_text(json.dumps(plan))
    for _ in range(2):
        (result,) = asyncio.run(repair(take.folder, wait_s=0, address=Address("127.0.0.1", 0), log=Log()))
        assert not result.ok
        assert "sessions repair" not in result.what
        assert f"sessions import {take.folder}{sep}images{sep}rig1" in result.what
    assert (take.folder / "images/rig1/cam0/000000.jpg").is_file()
