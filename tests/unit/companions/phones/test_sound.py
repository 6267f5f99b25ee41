"""Phones' microphones: their sound is in their images, on the gateway's time, if it was asked for."""

from pathlib import Path

from capture_app.common.host_clock import host_ns
from capture_app.plugins.cameras.sound.microphones import SimulatedSound
from tests.unit.companions.phones.places import burst, ready, serving
from tests.unit.companions.phones.stand_in import JPEG


async def test_sound_that_was_not_asked_for_is_not_recorded(tmp_path: Path) -> None:
    async with serving(tmp_path) as place:
        phone = await place.phone()
        await phone.join()
        await phone.open_camera()
        await phone.hear(SimulatedSound(host_ns()))
        await ready(place, "left")
        session = await burst(place, 2)
    assert [session.image_bytes(image) for image in session.manifest.images] == [JPEG] * 2
