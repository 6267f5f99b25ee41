"""One scene cut apart into videos with unknown offsets, imported again: offsets within their errors."""

from dataclasses import replace
from pathlib import Path

import pytest

from capture_app.session.format.common_times import NOT_SYNCHRONIZED
from tests.unit.plugins.footage.cut_apart import Phone, Take
from tests.unit.plugins.footage.offsets import PHONES, error_ms
from tests.unit.plugins.footage.test_imported_recordings import (
    CLAPS,
    claps,  # noqa: F401 - a fixture
    imported,
)


def test_claps_align_videos(claps: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exact = ("--sound-distance-m", "0", "--sound-delay-ms", "0")
    session = imported(claps, "--times", "video", *exact, "--start", "60", "--count", "40")
    times = session.manifest.burst.common_times
    assert times is not None
    assert (times.state, times.reference) == ("aligned", "a")
    for phone in PHONES[1:]:
        of = times.cameras[phone.name]
        assert of.source == "sound"
        error, bar = error_ms(of, phone, 4.0)
        assert abs(error) < bar < 1
    # No picture is made or changed for it; frames that are nearest to each other are paired by it.
    pairs = [images for images in session.images_by_instant() if len(images) == 3]
    assert len(pairs) > 25
    for image in (image for images in pairs for image in images.values()):
        phone = next(phone for phone in PHONES if phone.name == image.camera)
        assert image.local_ns is not None
        assert abs(image.leader_ns / 1e9 - float(PHONES[0].own_s(phone.true_s(image.local_ns / 1e9)))) < 1e-3
        assert abs(image.residual_ns) < 17e6
    assert "by sound" in capsys.readouterr().out


def test_a_sound_goes_on_in_the_next_chapter(tmp_path: Path) -> None:
    """Two GoPro recordings, of which only the second chapters were there at the claps."""
    heard = Take(claps_s=(7.2, 8.31, 9.87, 11.05))
    for phone, number in zip(PHONES, ("0011", "0021", "0031"), strict=True):
        for chapter in (1, 2):
            path = tmp_path / "rec" / phone.name / f"GX0{chapter}{number}.MP4"
            # Its frames go on without a gap.
            begun_s = float(phone.true_s(0.0 if chapter == 1 else int(6 * phone.fps) / phone.fps))
            seed = 10 * chapter + phone.seed
            replace(phone, start_s=begun_s, seed=seed, jitter_s=0.0).record(heard, path, 6)
    exact = ("--sound-distance-m", "0", "--sound-delay-ms", "0")
    times = imported(tmp_path / "rec", *exact, "--count", "3").manifest.burst.common_times
    assert times is not None
    for phone in PHONES[1:]:
        error, bar = error_ms(times.cameras[phone.name], phone, 8.0)
        assert times.cameras[phone.name].source == "sound"
        assert abs(error) < bar < 3


def test_a_faster_camera_gives_its_nearest_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    slow, fast = Phone("a", fps=25), Phone("b", start_s=0.7, fps=60_000 / 1001, seed=2)
    for phone in (slow, fast):
        phone.record(CLAPS, tmp_path / "rec" / f"{phone.name}.mp4", 8)
    session = imported(tmp_path / "rec")
    pairs = session.images_by_instant()
    assert all(len(images) == 2 for images in pairs)
    assert len(pairs) == pytest.approx(25 * 7.3, abs=2)
    assert all(abs(image.residual_ns) < 8.4e6 for images in pairs for image in images.values())
    assert session.manifest.burst.period_ns == 40_000_000
    assert "b 59.94 frames a second, a 25: the nearest are taken" in capsys.readouterr().err


def test_the_way_of_sound_is_in_the_error_bar(claps: Path) -> None:
    times = imported(claps, "--times", "video", "--start", "60", "--count", "3").manifest.burst.common_times
    assert times is not None
    # And how late a camera's sound is, which it does not tell.
    assert (times.cameras["b"].uncertainty_ns or 0) > 1 / 343 * 1e9 + 20e6


def test_sounds_that_share_nothing_align_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for phone, take in zip(PHONES[:2], (Take(claps_s=(2.0, 3.3), seed=5), Take()), strict=True):
        phone.record(take, tmp_path / "rec" / f"{phone.name}.mp4", 5)
    times = imported(
        tmp_path / "rec", "--times", "video", "--start", "60", "--count", "3"
    ).manifest.burst.common_times
    assert times is not None
    assert times.unknown
    assert not times.cameras
    assert "by sound" in times.reason
    assert NOT_SYNCHRONIZED in capsys.readouterr().out


def test_flashes_align_rolling_shutters(tmp_path: Path) -> None:
    take = Take(flashes_s=tuple(1.6 + 0.371 * n + 0.02 * n**2 for n in range(11)))
    for phone in PHONES:
        phone.record(take, tmp_path / "rec" / f"{phone.name}.mp4", 7, sound=False)
    few = ("--start", "60", "--count", "3")
    session = imported(tmp_path / "rec", "--align", "flash", "--times", "video", *few)
    times = session.manifest.burst.common_times
    assert times is not None
    assert times.state == "aligned"
    for phone in PHONES[1:]:
        assert times.cameras[phone.name].source == "flash"
        error, bar = error_ms(times.cameras[phone.name], phone, 3.0)
        assert abs(error) < min(bar, 1.0)
        assert bar < 5


def test_a_timecode_that_sound_contradicts_is_not_taken(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for phone, code in zip(PHONES, ("10:00:00:00", "10:00:05:00", ""), strict=True):
        take = Take(claps_s=CLAPS.claps_s, lamp_s=(2.9, 5.1)) if phone.name != "c" else CLAPS
        coded = replace(phone, fps=30, exposure_s=0.004, timecode=code)
        coded.record(take, tmp_path / "rec" / f"{phone.name}.mp4", 8)
    times = imported(tmp_path / "rec", "--start", "70", "--count", "3").manifest.burst.common_times
    assert times is not None
    # Each camera by what tells it best: the third one saw no flash.
    assert [times.cameras[name].source for name in "bc"] == ["flash", "sound"]
    for phone in PHONES[1:]:
        error, bar = error_ms(times.cameras[phone.name], phone, 4.0)
        assert abs(error) < bar < 25
    said = capsys.readouterr().err
    assert "by timecode: b: +5000.0 ± 33.3 ms, not taken: others differ" in said
    assert "by flash: b: " in said


@pytest.mark.parametrize(
    ("take", "exposure_s"),
    [
        # Between a short exposure and the next one a flash may be missed, a lamp may not.
        (Take(flashes_s=(2.3,)), 0.018),
        (Take(flashes_s=(2.3,)), 0.03),
        (Take(lamp_s=(2.3,)), 0.004),
        (Take(lamp_s=(2.3,)), 0.03),
        (Take(lamp_s=(2.31, 3.42)), 0.004),
        (Take(lamp_s=(2.31, 3.42)), 0.03),
    ],
)
def test_one_flash_or_lamp_is_an_answer_with_its_bar(tmp_path: Path, take: Take, exposure_s: float) -> None:
    for phone in PHONES[:2]:
        exposed = replace(phone, exposure_s=exposure_s)
        exposed.record(take, tmp_path / "rec" / f"{phone.name}.mp4", 5, sound=False)
    session = imported(tmp_path / "rec", "--start", "70", "--count", "3", "--align", "flash")
    times = session.manifest.burst.common_times
    assert times is not None
    assert times.state == "aligned"
    of = times.cameras["b"]
    error, bar = error_ms(of, PHONES[1], 2.3 - PHONES[1].start_s)
    assert abs(error) < bar < 40
    assert ("alone" in of.reason) == (len(take.lamp_s) < 2)
    assert (of.rate_uncertainty_ppm or 0) >= 100
