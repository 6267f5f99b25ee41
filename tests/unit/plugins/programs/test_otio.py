"""The timeline of a take, read back by OpenTimelineIO, and its videos by PyAV."""

import sys
from pathlib import Path
from typing import Any

import av
import pytest

from capture_app.common.errors import NotAvailableError
from tests.unit.plugins.programs.conftest import PERIOD_NS, RESIDUALS_NS, START_NS, Export, Make

otio: Any = pytest.importorskip("opentimelineio")


def test_a_timeline_holds_every_camera_where_it_was(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(), "otio")
    timeline = otio.adapters.read_from_file(str(tmp_path / "out/timeline.otio"))
    earliest_ns = min(RESIDUALS_NS.values())
    assert [track.name for track in timeline.video_tracks()] == ["left", "mid", "right"]
    for track in timeline.video_tracks():
        (clip,) = track.find_clips()
        begin = clip.range_in_parent().start_time
        late_ns = RESIDUALS_NS[track.name] - earliest_ns
        assert begin.rate == pytest.approx(1e9 / PERIOD_NS)
        assert begin.to_seconds() * 1e9 == pytest.approx(late_ns, abs=1)
        assert clip.metadata["simulshot"]["leader_ns"] == START_NS + RESIDUALS_NS[track.name]
        with av.open(str(tmp_path / "out" / clip.media_reference.target_url)) as film:
            frames = list(film.decode(video=0))
            code = film.streams.video[0].metadata["timecode"]
        start = clip.media_reference.available_range.start_time
        assert otio.opentime.to_timecode(start, start.rate, False) == code
        assert start == clip.source_range.start_time
        assert abs((start - timeline.global_start_time).to_seconds() - late_ns / 1e9) <= PERIOD_NS / 2e9
        assert frames[0].time == 0
        # From the first frame to the end of the last, six periods at rest.
        assert clip.duration().to_seconds() == pytest.approx(
            float(frames[-1].time) + PERIOD_NS / 1e9, abs=2e-6
        )


def test_without_the_package_it_says_how_to_get_it(
    make: Make, export: Export, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "opentimelineio", None)
    with pytest.raises(NotAvailableError, match="OpenTimelineIO needs opentimelineio"):
        export(make(), "otio")
