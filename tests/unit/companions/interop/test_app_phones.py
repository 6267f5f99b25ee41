"""Stand-ins for phones with the app follow a leader over sockets, on the app's own ports."""

import asyncio
import os
import socket
from collections.abc import AsyncIterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import pytest

from capture_app.common.clock import HostClock, SimulatedClock
from capture_app.common.errors import BadInputError, NetworkError
from capture_app.common.host_clock import host_ns
from capture_app.companions.interop.app_phones import AppPhones
from capture_app.companions.interop.app_protocol import CALL_PORT, PERIOD_NS
from capture_app.node.burst.burst_session import BurstSession
from capture_app.protocol.log import Log
from capture_app.protocol.messages import BurstRequest
from capture_app.session.importing.import_options import ImportOptions
from capture_app.session.importing.recording import import_recording
from capture_app.sync.rig.frame_selection import Burst
from tests.unit.companions.interop.app_phone_on_sockets import PhoneOnSockets
from tests.unit.session.conftest import jpeg
from tests.waiting import SLOW_PATIENCE_S, until

S = 1_000_000_000
HOST = f"127.{os.getpid() % 200 + 20}.{os.getpid() // 200 % 250 + 1}"
"""The app's ports are fixed: tests that run side by side have addresses of their own."""


@dataclass
class Take:
    """A burst under way."""

    burst: Burst
    finished: asyncio.Event = field(default_factory=asyncio.Event)


def a_take(burst: Burst) -> BurstSession:
    """One of which phones look at the burst and its end only."""
    return cast(BurstSession, Take(burst))


class PhoneRig:
    """A leader's phones, one of them here."""

    def __init__(self) -> None:
        self.news = Log()
        self.phones = AppPhones(f"{HOST}.1", aligns=False)
        self.one = PhoneOnSockets("a3f1", f"{HOST}.2", f"{HOST}.1", SimulatedClock(7200 * S, 20.0))

    @property
    def lines(self) -> str:
        return "\n".join(line.text for line in self.news.after(0))


@pytest.fixture
async def rig() -> AsyncIterator[PhoneRig]:
    made = PhoneRig()
    made.phones.start(HostClock(), made.news)
    try:
        async with made.one:
            await until(lambda: made.one.is_synced, seconds=SLOW_PATIENCE_S)
            yield made
    finally:
        await made.phones.close()


def burst_of(*instants_ns: int, video: bool = False) -> Burst:
    return Burst(1, instants_ns, PERIOD_NS, instants_ns[0], ("cam",), streamed=video, video=video)


def write_as_the_app(folder: Path, rig: PhoneRig) -> None:
    """What libsoftwaresync leaves on the phone: a folder for each trigger."""
    for number, picture in enumerate(rig.one.phone.pictures):
        place = folder / "a3f1" / f"19700101_00000{number}_000"
        place.mkdir(parents=True)
        times = {"leader": picture.leader_ns, "local": picture.local_ns}
        text = "".join(f"{clock}_sensor_timestamp_ns: {ns}\n" for clock, ns in times.items())
        (place / f"sync_metadata_{place.name}.txt").write_text(text)
        (place / f"img_{place.name}.jpg").write_bytes(jpeg(1))


async def test_a_phone_takes_part_in_a_burst_and_its_pictures_are_imported(
    rig: PhoneRig, tmp_path: Path
) -> None:
    (status,) = rig.phones.statuses()
    assert (status.name, status.state, status.address) == ("a3f1", "synced", f"{HOST}.2")
    assert status.hard_bound_ns is not None
    assert abs(rig.one.error_us()) * 1000 < status.hard_bound_ns + 1_000_000
    now_ns = host_ns()
    instants = [now_ns + 3 * S, now_ns + 3 * S + S // 4, now_ns + 6 * S]
    rig.phones.take_part(a_take(burst_of(*instants)))
    await until(lambda: len(rig.one.phone.pictures) == 2)
    assert "ordered to take 2 of 3 instants" in rig.lines
    assert "phone a3f1 has the time" in rig.lines
    write_as_the_app(tmp_path / "phones", rig)
    session = import_recording([str(tmp_path / "phones" / "a3f1")], tmp_path, "s", ImportOptions())
    taken = [(image.leader_ns, image.local_ns) for image in session.manifest.images]
    assert taken == [(picture.leader_ns, picture.local_ns) for picture in rig.one.phone.pictures]
    assert {camera.facts.kind for camera in session.manifest.cameras} == {"imported"}


async def test_a_phone_records_until_the_recording_is_ended(rig: PhoneRig) -> None:
    now_ns = host_ns()
    take = a_take(burst_of(now_ns + S, now_ns + 3600 * S, video=True))
    rig.phones.take_part(take)
    await until(lambda: rig.one.phone.recordings == ["start"])
    take.burst = replace(take.burst, instants_ns=(now_ns + 1,))
    await until(lambda: rig.one.phone.recordings == ["start", "stop"])


async def test_a_recording_ends_with_the_leader(rig: PhoneRig) -> None:
    now_ns = host_ns()
    rig.phones.take_part(a_take(burst_of(now_ns + S, now_ns + 3600 * S, video=True)))
    await until(lambda: rig.one.phone.recordings == ["start"])
    await rig.phones.close()
    await until(lambda: rig.one.phone.recordings == ["start", "stop"])


async def test_phones_take_pictures_where_there_is_no_camera(rig: PhoneRig) -> None:
    told = rig.phones.take_alone(BurstRequest(frames=2, interval_s=3.0))
    assert told.startswith("1 phone with the app ordered to take 2 of 2 instants")
    await until(lambda: len(rig.one.phone.pictures) == 2)
    first, second = (picture.leader_ns for picture in rig.one.phone.pictures)
    assert abs(second - first - 3 * S) < 2 * PERIOD_NS


async def test_phones_record_for_a_given_time_where_there_is_no_camera(rig: PhoneRig) -> None:
    with pytest.raises(BadInputError, match="for a given time"):
        rig.phones.take_alone(BurstRequest(video=True))
    assert "ordered to record" in rig.phones.take_alone(BurstRequest(video=True, seconds=0.2))
    await until(lambda: rig.one.phone.recordings == ["start", "stop"])


async def test_a_port_that_another_program_has_is_named() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((f"{HOST}.3", CALL_PORT))
        with pytest.raises(NetworkError, match="8244") as raised:
            AppPhones(f"{HOST}.3", aligns=False).start(HostClock(), Log())
        assert "no other port" in raised.value.hint


async def test_without_phones_nothing_is_said(tmp_path: Path) -> None:
    news = Log()
    phones = AppPhones(f"{HOST}.4", aligns=False)
    phones.start(HostClock(), news)
    phones.take_part(a_take(burst_of(host_ns() + S)))
    await phones.close()
    assert phones.take_alone(BurstRequest(frames=1)) == ""
    assert news.after(0) == ()
    assert phones.statuses() == ()
