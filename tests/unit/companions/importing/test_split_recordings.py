"""Files into which a camera splits a recording are one; takes of one camera are not its cameras."""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import av
import numpy as np
import pytest

from capture_app.companions.importing.clips import find_shoots
from capture_app.session.importing.recording_sources import Video, later_chapters

DAY = datetime(2026, 5, 1, 10, tzinfo=UTC)
Clip = tuple[str, float, float]
"""A file, its beginning and its length, s."""


def write(folder: Path, clips: Sequence[Clip], *, dated: bool = True) -> None:
    for name, begin_s, length_s in clips:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        with av.open(str(folder / name), "w") as container:
            if dated:
                container.metadata["creation_time"] = f"{DAY + timedelta(seconds=begin_s):%Y-%m-%dT%H:%M:%SZ}"
            stream = container.add_stream("mpeg4", rate=2)
            stream.width = stream.height = 32
            for number in range(round(2 * length_s)):
                frame = av.VideoFrame.from_ndarray(np.full((32, 32, 3), 40, np.uint8))
                frame.pts, frame.time_base = number, 1 / stream.average_rate
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))


def found(folder: Path) -> list[dict[str, str]]:
    shoots, _ = find_shoots(folder)
    return [{name: clip.path.name for name, clip in clips.items()} for _, clips in shoots]


PARTS: dict[str, Sequence[Clip]] = {
    "two": [("DJI_0041.MP4", 0, 6), ("DJI_0042.MP4", 6, 4)],
    "three, dates rounded": [("C0001.MP4", 0, 6), ("C0002.MP4", 7, 6), ("C0003.MP4", 12, 6)],
    "a date and a counter": [
        (f"DJI_2026050110{n:04}_{k:04}_D.MP4", n, 6) for k, n in enumerate((0, 6, 12), 1)
    ],
}
NOT_PARTS: dict[str, Sequence[Clip]] = {
    "a gap": [("DJI_0041.MP4", 0, 6), ("DJI_0042.MP4", 9, 4)],
    "one between was deleted": [("DJI_0041.MP4", 0, 6), ("DJI_0043.MP4", 6, 4)],
    "the second is longer": [("DJI_0041.MP4", 0, 6), ("DJI_0042.MP4", 6, 8)],
    "other words": [("DJI_0041.MP4", 0, 6), ("DJX_0042.MP4", 6, 4)],
    "short clips of two cameras": [("serial_11.MP4", 0, 1), ("serial_12.MP4", 2.5, 1)],
}


@pytest.mark.parametrize("clips", PARTS.values(), ids=PARTS)
def test_parts_are_one_recording(tmp_path: Path, clips: Sequence[Clip]) -> None:
    write(tmp_path, clips)
    (first, *later) = (tmp_path / name for name, *_ in clips)
    assert later_chapters(first) == later
    assert found(tmp_path) == [{first.stem: first.name}]
    video = Video("a", first)
    assert len(video.numbers) == sum(2 * length_s for *_, length_s in clips)
    assert video.own_times_ns()[-1] == (len(video.numbers) - 1) * 500_000_000


@pytest.mark.parametrize("clips", NOT_PARTS.values(), ids=NOT_PARTS)
def test_other_clips_are_no_parts(tmp_path: Path, clips: Sequence[Clip]) -> None:
    write(tmp_path, clips)
    assert later_chapters(tmp_path / clips[0][0]) == []


def test_a_third_part_after_a_shorter_second_is_another_recording(tmp_path: Path) -> None:
    write(tmp_path, [("DJI_0041.MP4", 0, 6), ("DJI_0042.MP4", 6, 3), ("DJI_0043.MP4", 9, 3)])
    assert later_chapters(tmp_path / "DJI_0041.MP4") == [tmp_path / "DJI_0042.MP4"]


def test_a_recording_without_dates_goes_on_by_the_dates_in_its_names(tmp_path: Path) -> None:
    names = [f"20260501_1000{second:02}.MP4" for second in (0, 5, 10)]
    write(tmp_path, [(name, 0, 5) for name in names], dated=False)
    assert later_chapters(tmp_path / names[0]) == [tmp_path / name for name in names[1:]]


def test_two_cameras_that_split_are_one_take(tmp_path: Path) -> None:
    write(tmp_path / "drone", [("DJI_0041.MP4", 0, 6), ("DJI_0042.MP4", 6, 4)])
    write(tmp_path / "osmo", [("DJI_0141.MP4", 1, 6), ("DJI_0142.MP4", 7, 5)])
    assert found(tmp_path) == [{"drone": "DJI_0041.MP4", "osmo": "DJI_0141.MP4"}]


def test_clips_that_a_camera_counted_are_its_takes(tmp_path: Path) -> None:
    write(tmp_path, [("DJI_0041.MP4", 0, 6), ("DJI_0042.MP4", 60, 7)])
    shoots, notes = find_shoots(tmp_path)
    assert [(take, [*clips]) for take, clips in shoots] == [("DJI_0041", ["DJI"]), ("DJI_0042", ["DJI"])]
    assert "by their counters and dates, these clips are of one camera" in notes
