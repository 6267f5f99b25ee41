"""One scene cut apart into videos with unknown offsets, imported again: offsets within their errors."""

from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.session.format.common_times import NOT_SYNCHRONIZED
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.unit.plugins.footage.cut_apart import Phone, Take
from tests.unit.plugins.footage.offsets import PHONES

CLAPS = Take(claps_s=(2.2, 3.31, 4.87, 6.05))


def imported(folder: Path, *arguments: str) -> Session:
    name = f"s{len(list(folder.parent.iterdir()))}"
    call = ["sessions", "import", str(folder), "--out", str(folder.parent), "--name", name, *arguments]
    assert run(call) == ExitCode.OK
    session = Session.open(folder.parent / name)
    assert verify(session) == []
    return session


@pytest.fixture(scope="module")
def claps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cut") / "rec"
    for phone in PHONES:
        phone.record(CLAPS, folder / f"{phone.name}.mp4", 8)
    return folder


def test_what_was_not_asked_for_is_not_done(claps: Path, capsys: pytest.CaptureFixture[str]) -> None:
    times = imported(
        claps, "--times", "video", "--align", "none", "--start", "60", "--count", "3"
    ).manifest.burst.common_times
    assert times is not None
    assert times.unknown
    assert NOT_SYNCHRONIZED in capsys.readouterr().out


def test_a_rate_gives_sound_other_times(claps: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call = ["sessions", "import", str(claps), "--out", str(claps.parent), "--name", "by-rate"]
    assert run([*call, "--fps", "30", "--align", "sound"]) == ExitCode.BAD_INPUT
    assert "--align sound takes the videos' own times" in capsys.readouterr().err


def test_videos_without_sound_are_asked_by_all_other_methods(tmp_path: Path) -> None:
    for phone in PHONES[:2]:
        phone.record(Take(), tmp_path / "rec" / f"{phone.name}.mp4", 2, sound=False)
    times = imported(tmp_path / "rec", "--align", "sound", "--count", "3").manifest.burst.common_times
    assert times is not None
    assert times.unknown
    assert "it has no sound, leave --align sound out, and all other methods are tried" in times.reason


def test_a_flash_that_only_one_saw_twice_may_be_any(tmp_path: Path) -> None:
    for phone, flashes_s in zip(PHONES, ((2.3,), (2.3, 3.4)), strict=False):
        phone.record(Take(flashes_s=flashes_s), tmp_path / "rec" / f"{phone.name}.mp4", 4, sound=False)
    times = imported(tmp_path / "rec", "--start", "70", "--count", "3").manifest.burst.common_times
    assert times is not None
    assert times.unknown
    assert "fit at several offsets" in times.reason


def test_a_lamp_that_goes_off_is_not_one_that_goes_on(tmp_path: Path) -> None:
    for phone, lamp_s in zip(PHONES, ((2.3,), (-9, 2.3)), strict=False):
        phone.record(Take(lamp_s=lamp_s), tmp_path / "rec" / f"{phone.name}.mp4", 4, sound=False)
    times = imported(tmp_path / "rec", "--start", "70", "--count", "3").manifest.burst.common_times
    assert times is not None
    assert times.unknown


def test_timecodes_align_to_a_frame(tmp_path: Path) -> None:
    codes = {"a": "10:00:00:00", "b": "10:00:00:06"}
    for phone in PHONES[:2]:
        still = Phone(phone.name, fps=30, timecode=codes[phone.name])
        still.record(Take(), tmp_path / "rec" / f"{phone.name}.mp4", 3, sound=False)
    for arguments in (["--times", "video"], ["--fps", "30"]):
        session = imported(tmp_path / "rec", *arguments, "--count", "20", "--align", "timecode")
        times = session.manifest.burst.common_times
        assert times is not None
        of = times.cameras["b"]
        assert (times.state, of.source, of.offset_ns) == ("aligned", "timecode", 200_000_000)
        assert of.uncertainty_ns == pytest.approx(1e9 / 30, abs=1)
        both = [images for images in session.images_by_instant() if len(images) == 2]
        assert {(i["a"].sequence or 0) - (i["b"].sequence or 0) for i in both} == {6}


def test_a_timecode_of_a_gopro_is_as_accurate_as_its_clock(tmp_path: Path) -> None:
    for name, code in (("GX010012", "00:03:11:04"), ("GX010034", "00:03:11:20")):
        still = Phone(name, fps=30, timecode=code)
        still.record(Take(), tmp_path / "rec" / f"{name}.MP4", 2, sound=False)
    for how, known in (("auto", False), ("timecode", True)):
        times = imported(tmp_path / "rec", "--count", "3", "--align", how).manifest.burst.common_times
        assert times is not None
        assert times.unknown != known
    assert (times.cameras["GX010034"].uncertainty_ns or 0) > 2e9
