"""Sound of IP cameras, in their images: on the time of the frames, in both codes of G.711, or not at all."""

import logging

import pytest

from capture_app.cameras.frames import CapturedFrame
from capture_app.plugins.cameras.rtsp import rtsp_camera
from capture_app.plugins.cameras.rtsp.rtsp_camera import RtspCamera
from capture_app.plugins.cameras.rtsp.rtsp_sound import A_LAW, MU_LAW, _levels, parse_sound
from capture_app.plugins.cameras.sound.image_sound import SoundPart, sounds_of
from capture_app.plugins.cameras.sound.sound_camera import SoundCamera
from tests.unit.plugins.cameras.rtsp.ip_camera import FPS, IpCamera
from tests.unit.plugins.programs.clicks import click_errors_ms
from tests.waiting import until


async def images_of(source: IpCamera, seconds: float, *, with_sound: bool = True) -> list[CapturedFrame]:
    """Frames whose images have been encoded as they came."""
    frames: list[CapturedFrame] = []
    async with source.running():
        inner = RtspCamera(source.url(), reports_s=1.0)
        camera = SoundCamera(inner, inner.microphone, "left") if with_sound else inner
        try:
            await camera.start(frames.append, lambda _: None)
            await until(lambda: len(frames) >= seconds * FPS)
        finally:
            await camera.stop()
    return frames


def parts_of(frames: list[CapturedFrame]) -> list[SoundPart]:
    return [part for frame in frames for part in sounds_of(frame.picture.encode())]


@pytest.mark.parametrize(("sound", "every_s"), [("8", 0.2), ("0", 0.2), ("8", None)])
async def test_clicks_are_where_the_camera_heard_them(
    sound: str, every_s: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rtsp_camera, "host_from_monotonic", int)
    source = IpCamera(sound=sound, rate_ppm=100.0, report_every_s=every_s)
    parts = parts_of(await images_of(source, 3.5))
    errors_ms = click_errors_ms(parts, louder_than=10_000)
    assert len(errors_ms) >= 2
    # Without reports, the camera's own delay is not known.
    late_ms = 0.0 if every_s else 1000 * source.sound_delay_s
    assert errors_ms == pytest.approx([late_ms] * len(errors_ms), abs=10.0)


async def test_sound_is_asked_for_only_where_it_is_wanted() -> None:
    source = IpCamera()
    assert parts_of(await images_of(source, 0.5, with_sound=False)) == []
    assert source.tracks == ["track1"]


async def test_a_camera_whose_sound_cannot_be_read_is_silent(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    source = IpCamera(sound="97")
    assert parts_of(await images_of(source, 0.5)) == []
    assert source.tracks == ["track1"]
    assert [record.getMessage() for record in caplog.records] == [
        "left: images have no sound for now: 127.0.0.1 sends no sound that is read"
        " (switch its sound on, as G.711 (PCMU or PCMA))"
    ]


def test_the_codes_of_g711() -> None:
    """The first and last codes of each sign, after ITU-T G.711, in 16 bits."""
    assert [int(_levels(A_LAW)[code]) for code in (0xD5, 0x55, 0xAA, 0x2A)] == [8, -8, 32256, -32256]
    assert [int(_levels(MU_LAW)[code]) for code in (0xFF, 0x7F, 0x80, 0x00)] == [0, 0, 32124, -32124]


@pytest.mark.parametrize("text", ["", "m=audio", "m=audio 0 RTP/AVP 8", "m=audio 0 RTP/AVP x\na=control:t"])
def test_a_description_without_sound_that_is_read(text: str) -> None:
    assert parse_sound(text) is None
