"""Stand-ins for phones with the paper's app take part in a rig of processes, by the app's own datagrams."""

import json
import re
import socket
from pathlib import Path

from capture_app.common.errors import ExitCode
from capture_app.session.reading.array_access import open_session
from tests.system.end_to_end.conftest import Start
from tests.system.end_to_end.rig import burst, lead, output
from tests.unit.companions.softwaresync.app_phone import ALIGNED_NS, CALL_PORT, AppPicture
from tests.unit.companions.softwaresync.phone_on_sockets import NETWORK, PhoneOnSockets
from tests.unit.session.conftest import jpeg
from tests.waiting import SLOW_PATIENCE_S, until

TOTAL_NS = 121_000
"""Largest error in the paper, of clock and phase together (ICCP 2019, LED panel)."""
CAMERA = "sim:perfect,scale=0.1,drops=0"


def write_as_the_app(folder: Path, name: str, picture: AppPicture) -> Path:
    """What libsoftwaresync leaves on the phone: a folder for each trigger."""
    place = folder / name / "19700101_000000_000"
    place.mkdir(parents=True)
    times = {"leader": picture.leader_ns, "local": picture.local_ns}
    text = "".join(f"{clock}_sensor_timestamp_ns: {ns}\n" for clock, ns in times.items())
    (place / f"sync_metadata_{place.name}.txt").write_text(text)
    (place / f"img_{place.name}.jpg").write_bytes(jpeg(1))
    return folder / name


async def test_two_phones_take_the_frame_of_the_instant_that_the_rig_takes(
    start: Start, tmp_path: Path
) -> None:
    _, leader = await lead(start, tmp_path, options=("--camera", CAMERA, "--fps", "30.012"))
    host = f"{NETWORK}.1"
    app = await start("softwaresync", "--leader", leader, "--host", host)
    await app.says("There is no pairing")
    async with PhoneOnSockets("a3f1", 2, host, 20.0) as first, PhoneOnSockets("b7", 3, host, -15.0) as second:
        both = (first, second)
        await app.says("phones move their frames onto the rig's instants")

        def are_in_step() -> bool:
            return all(
                of.phone.is_synced(of.clock.now_ns()) and abs(of.phone.phase_error_ns()) < 100_000
                for of in both
            )

        await until(are_in_step, seconds=SLOW_PATIENCE_S)
        taken = await burst(start, leader, "--frames", "3")
        line = await app.says("2 phones to save one frame")
        shift_ms = re.search(r"--time-shift-ms PHONE=(\S+)", line)
        assert shift_ms is not None
        epoch_ns = -round(float(shift_ms[1]) * 1e6)
        await until(lambda: all(of.phone.pictures for of in both))
        errors_ns = [of.time_error_ns(epoch_ns) for of in both]
        pictures = [of.phone.pictures for of in both]
    rig = open_session(taken["session"]).manifest
    instant_ns = rig.burst.instants_ns[0]
    assert [len(of) for of in pictures] == [1, 1]
    assert max(map(abs, errors_ns)) < TOTAL_NS
    # The app calls 100 us aligned, from one of its frames, to its account of time.
    assert max(abs(of.true_ns - instant_ns) for (of,) in pictures) < ALIGNED_NS + TOTAL_NS
    assert abs(pictures[0][0].true_ns - pictures[1][0].true_ns) < 2 * ALIGNED_NS
    folders = [write_as_the_app(tmp_path / "phones", of.phone.name, of.phone.pictures[0]) for of in both]
    shifts = [f"--time-shift-ms={folder.name}={shift_ms[1]}" for folder in folders]
    imported = await start(
        "sessions", "import", *map(str, folders), *shifts, "--out", str(tmp_path / "imported"), "--json"
    )
    images = open_session(json.loads(await output(imported))["session"]).manifest.images
    assert {image.camera for image in images} == {"a3f1", "b7"}
    assert {image.instant for image in images} == {0}
    assert all(abs(image.leader_ns - instant_ns) < ALIGNED_NS + TOTAL_NS for image in images)


async def test_a_port_that_another_program_has_is_named(start: Start, tmp_path: Path) -> None:
    _, leader = await lead(start, tmp_path)
    host = f"{NETWORK}.4"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((host, CALL_PORT))
        app = await start("softwaresync", "--leader", leader, "--host", host)
        await app.finish()
    assert app.process.returncode == ExitCode.NETWORK
    assert f"cannot listen on {host}:8244" in app.said[-1]
    assert "no other port" in app.said[-1]
