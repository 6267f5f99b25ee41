"""Videos that OpenCV does not decode, or does not count: what is saved was decoded."""

import sys
from pathlib import Path

import av
import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.session.importing import video_tracks
from capture_app.session.reading.reader import Session
from tests.unit.companions.importing.numbered_video import numbers_of, write_video

REGULAR_US = [40_000 * number for number in range(8)]


@pytest.mark.parametrize("how", [["--synchronized"], ["--fps", "25"], ["--times", "video"]])
def test_interlaced_frames_are_decoded_and_reported_once(
    how: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b"):
        write_video(tmp_path / "rec" / f"{name}.mp4", REGULAR_US, interlaced=True)
    assert run(["sessions", "import", str(tmp_path / "rec"), *how, "--out", str(tmp_path / "s")]) == 0
    assert numbers_of(Session.open(tmp_path / "s" / "rec")) == [{"a": n, "b": n} for n in range(8)]
    said = capfd.readouterr().err
    assert said.count("a.mp4 is interlaced: ") == 1
    assert "swscaler" not in said


def test_a_video_of_huge_pictures_is_not_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_video(tmp_path / "rec" / "a.mp4", REGULAR_US)
    monkeypatch.setattr(video_tracks, "MAX_PIXELS", 1000)
    call = ["sessions", "import", str(tmp_path / "rec"), "--out", str(tmp_path / "s")]
    assert run(call) == ExitCode.BAD_INPUT
    assert "its pictures have " in capsys.readouterr().err


def test_without_pyav_no_video_is_read_and_the_command_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b"):
        write_video(tmp_path / "rec" / f"{name}.mp4", REGULAR_US)
    monkeypatch.setitem(sys.modules, "av", None)
    for sources in ([f"{name}={tmp_path}/rec/{name}.mp4" for name in "ab"], [str(tmp_path / "rec")]):
        assert run(["sessions", "import", *sources, "--out", str(tmp_path / "s")]) == ExitCode.NOT_AVAILABLE
        assert "reading videos needs av, which is not installed" in capsys.readouterr().err


def cut(source: Path, target: Path, start_us: int) -> Path:
    """Cut without encoding: the frames since the key frame stay, hidden by an edit list."""
    with av.open(str(source)) as whole, av.open(str(target), "w") as rest:
        stream = whole.streams.video[0]
        copied = rest.add_stream_from_template(stream)
        shift = round(start_us / 1e6 / stream.time_base)
        for packet in whole.demux(stream):
            if packet.dts is not None and packet.pts is not None:
                packet.pts, packet.dts = packet.pts - shift, packet.dts - shift
                packet.stream = copied
                rest.mux(packet)
    return target


def test_frames_that_an_edit_list_hides_have_no_numbers(tmp_path: Path) -> None:
    whole = write_video(tmp_path / "whole.mp4", REGULAR_US)
    (tmp_path / "rec").mkdir()
    for name, start_us in (("a", 80_000), ("b", 160_000)):
        cut(whole, tmp_path / "rec" / f"{name}.mp4", start_us)
    call = ["sessions", "import", str(tmp_path / "rec"), "--synchronized", "--out", str(tmp_path / "s")]
    assert run(call) == ExitCode.OK
    pairs = [numbers for numbers in numbers_of(Session.open(tmp_path / "s" / "rec")) if len(numbers) == 2]
    assert pairs == [{"a": 2 + n, "b": 4 + n} for n in range(4)]
