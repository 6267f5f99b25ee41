"""Phones' microphones: their sound is in their images, on the gateway's time, if it was asked for."""

import asyncio
from pathlib import Path

import numpy as np
import pytest

from capture_app.common.host_clock import host_ns
from capture_app.plugins.cameras.sound.image_sound import SoundPart, read_sounds
from capture_app.plugins.cameras.sound.microphones import SimulatedSound
from capture_app.plugins.cameras.sound.sound_ring import RATE_HZ
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.browser import CHROMIUM
from tests.system.companions.phones.test_in_a_browser import ALLOW, join
from tests.unit.companions.phones.places import burst, measured, ready, serving
from tests.unit.companions.phones.test_in_a_browser import PhoneBrowser
from tests.unit.plugins.programs.clicks import click_errors_ms


def sound_of(session: Session) -> list[SoundPart]:
    assert verify(session) == []
    (camera,) = session.manifest.cameras
    return [part for _, part in read_sounds(session, camera.name)]


REFUSED = """
const ask = navigator.mediaDevices.getUserMedia.bind(navigator.mediaDevices);
navigator.mediaDevices.getUserMedia = wanted => wanted.audio
  ? Promise.reject(new DOMException("no", "NotAllowedError")) : ask(wanted);
"""


async def test_a_phones_sound_is_on_the_gateways_time(tmp_path: Path) -> None:
    async with serving(tmp_path, sound=True) as place:
        phone = await place.phone()
        await phone.join()
        await phone.open_camera()
        await phone.hear(SimulatedSound(host_ns(), ppm=100.0))
        await ready(place, "left")
        await asyncio.sleep(2.0)
        parts = sound_of(await burst(place, 40))
    errors_ms = click_errors_ms(parts)
    assert errors_ms
    assert max(map(abs, errors_ms)) < 5.0


@pytest.mark.skipif(CHROMIUM is None, reason="needs a headless Chromium")
async def test_a_browser_sends_its_microphone(tmp_path: Path) -> None:
    async with serving(tmp_path, sound=True) as place:
        phone = PhoneBrowser(tmp_path / "profile", ALLOW)
        try:
            await join(phone, place)
            await asyncio.sleep(2.0)
            parts = sound_of(await burst(place, 20, wait_ready_s=0))
        finally:
            phone.kill()
    heard = np.concatenate([np.frombuffer(part.pcm, "<i2") for part in parts])
    assert len(heard) > RATE_HZ
    # Chromium's fake microphone beeps.
    assert np.abs(heard).max() > 1000


@pytest.mark.skipif(CHROMIUM is None, reason="needs a headless Chromium")
async def test_a_phone_whose_microphone_is_refused_is_a_silent_camera(tmp_path: Path) -> None:
    async with serving(tmp_path, sound=True) as place:
        phone = PhoneBrowser(tmp_path / "profile", ALLOW)
        try:
            await phone.open(place.url, before=REFUSED)
            await phone.ask("document.getElementById('wish').value = 'window'")
            await phone.ask("document.getElementById('go').click()")
            await measured(place, "window")
            await phone.shows("There is no sound")
            assert sound_of(await burst(place, 1, wait_ready_s=0)) == []
        finally:
            phone.kill()
