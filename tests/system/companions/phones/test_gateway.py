"""Phones that come, take part, go and come back, over real TLS and sockets, without a browser."""

from capture_app.common.camera_facts import StampSource
from capture_app.common.node_state import NodeState
from capture_app.session.reading.verify import verify
from tests.unit.companions.phones.places import Place, burst, ready
from tests.unit.companions.phones.stand_in import JPEG
from tests.unit.companions.phones.test_gateway import place  # noqa: F401 - a fixture
from tests.waiting import until


async def test_phones_join_align_take_a_burst_vanish_and_come_back(place: Place) -> None:
    phone = await place.phone()
    assert await phone.join() == "left"
    await phone.open_camera()
    other = await place.phone(name="right", zero_us=9e9, phase_us=23_000.0)
    assert await other.join() == "right"
    await other.open_camera()
    await ready(place, "left", "right")
    assert phone.restarts or other.restarts, "they were 16 ms apart"

    session = await burst(place, 3)
    assert verify(session) == []
    assert len(session.manifest.images) == 6
    for camera in session.manifest.cameras:
        assert camera.facts.kind == "phone"
        assert camera.facts.stamp_accuracy.source is StampSource.ASSUMED
        assert camera.clock is not None
        assert camera.clock.device_uncertainty_ns is not None
        assert 0 < camera.clock.device_uncertainty_ns <= (camera.clock.device_hard_bound_ns or 0)
    for image in session.manifest.images:
        assert session.image_bytes(image) == JPEG
        assert (image.uncertainty_ns or 0) > session.camera(image.camera).facts.stamp_accuracy.uncertainty_ns

    await phone.vanish()
    await until(lambda: place.state("left") is NodeState.FAILED)
    again = await place.phone(key=phone.key)
    again.secret = ""
    assert await again.join() == "left"
    await again.open_camera()
    await ready(place, "left", "right")
    assert len((await burst(place, 2)).manifest.images) == 4
    await until(lambda: "ready" in again.states or "degraded" in again.states)


async def test_a_page_in_the_background_is_told_and_comes_back(place: Place) -> None:
    phone = await place.phone()
    await phone.join()
    await phone.open_camera()
    await until(lambda: place.state("left") not in (None, NodeState.FAILED))
    await phone.say(type="page-hidden", why="its page is in the background")
    await until(lambda: place.state("left") is NodeState.FAILED)
    assert any("in the background" in line for line in place.said)
    await phone.open_camera()
    await until(lambda: place.state("left") not in (NodeState.FAILED, NodeState.LOST))


async def test_a_phone_that_is_turned_joins_anew(place: Place) -> None:
    phone = await place.phone()
    await phone.join()
    await phone.open_camera()
    await until(lambda: place.state("left") not in (None, NodeState.FAILED))
    await phone.say(type="opened", width=240, height=320, frame_rate=30.0, label="back")
    await until(lambda: any("another camera is connected" in line for line in place.said))
    await until(lambda: place.state("left") not in (NodeState.FAILED, NodeState.LOST))
    (camera,) = (await burst(place, 1)).manifest.cameras
    assert (camera.facts.width, camera.facts.height) == (240, 320)
